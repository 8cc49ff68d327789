"""Every reader against damaged files: it reads them or says in one line what is wrong; no
traceback, no hang, no flood of memory.

`make fuzz` runs it longer (`benchmarks/fuzz.py`).
"""

import random
import shutil
from pathlib import Path

import click
import pytest
from damaged_kinds import KINDS, try_damaged

from mocap_calib.errors import MocapCalibError

FILES = 25  # of each kind,
FEWER = {"cameras colmap-binary": 8}  # COLMAP takes up to 2 s for a count that is not true


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
    for seed in range(FEWER.get(name, FILES)):
        try_damaged(kind, tmp_path, random.Random(seed))


@pytest.mark.parametrize("name", KINDS)
def test_what_is_not_damaged_is_read(results, name, tmp_path):
    """By one of its readers at least: else damage would meet the same complaint each time."""
    kind = KINDS[name](results)
    for path, content in kind.files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    complaints = []
    calls = kind.calls(tmp_path, min(kind.files), random.Random(0))
    for call in calls:
        try:
            call()
        except (MocapCalibError, click.ClickException) as error:
            complaints.append(error)
    assert len(complaints) < len(calls), complaints
