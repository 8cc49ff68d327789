"""Every reader against damaged files: it reads them or says in one line what is wrong; no
traceback, no hang, no flood of memory.

`make fuzz` runs it longer (`benchmarks/fuzz.py`).
"""

import random
import shutil
from pathlib import Path

import pytest
from damaged_kinds import KINDS, try_damaged

FILES = 25  # of each kind


@pytest.fixture(scope="module")
def results(done, small, tool, tmp_path_factory) -> Path:
    """What `run` wrote, and `pairwise`."""
    out = Path(shutil.copytree(done[0], tmp_path_factory.mktemp("fuzz") / "out"))
    cameras = small / "intrinsics.toml"
    tool("pairwise", small / "keypoints", "--cameras", cameras, "-o", out / "pairs.json")
    return out


@pytest.mark.parametrize("name", KINDS)
def test_damage_is_read_or_refused(results, name, tmp_path):
    kind = KINDS[name](results)
    for seed in range(FILES):
        try_damaged(kind, tmp_path, random.Random(seed))
