"""Every reader against damaged files: it reads them or says in one line what is wrong; no
traceback, no hang, no flood of memory.

`make fuzz` runs it longer (`benchmarks/fuzz.py`).
"""

import random
import re
from pathlib import Path

import pytest
from damaged_kinds import KINDS, hold, lay_out, make_results, try_damaged

FILES = 25  # of each kind,
NO_COMPLAINT = (
    "expected a file or folder, found none|extrinsics|No such file"  # all else was read before that
)
FEWER = {"cameras colmap-binary": 2}  # COLMAP takes up to 2 s for a count that is not true


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    return make_results(tmp_path_factory.mktemp("results"))


@pytest.mark.parametrize("name", KINDS)
def test_what_is_not_damaged_is_read_and_damage_is_read_or_refused(results, name, tmp_path):
    kind = KINDS[name](results)
    lay_out(kind, tmp_path)
    complaints = [hold(call) for call in kind.calls(tmp_path)]
    assert not [each for each in complaints if each and not re.search(NO_COMPLAINT, each)]
    for seed in range(FEWER.get(name, FILES)):
        try_damaged(kind, tmp_path, random.Random(seed))
