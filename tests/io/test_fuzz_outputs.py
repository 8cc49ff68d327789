"""Every reader of cameras and of 3D poses against damaged files, as test_fuzz.py for keypoints;
`make fuzz` runs both longer.
"""

import json
import random
from pathlib import Path

import pytest
from corruption import corrupted
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from test_formats_cameras import WRITTEN, studio
from test_formats_poses import HERE, example
from test_fuzz import (
    CLOCK,
    EXAMPLES,
    MEMORY,
    SECONDS,
    damage_bytes,
    damage_hdf5,
    damage_json,
    spent,
)

from mocap_calib.errors import MocapCalibError
from mocap_calib.io.cameras.formats import CAMERA_FORMATS
from mocap_calib.io.cameras.read import parse_content
from mocap_calib.io.cameras.source import Source
from mocap_calib.io.cameras.write import format_rig
from mocap_calib.io.poses.read import parse_poses
from mocap_calib.io.poses.write import format_poses
from mocap_calib.io.registry import find_format

resource = pytest.importorskip("resource", reason="needs POSIX, which counts the peak of memory")
HDF5 = b"\x89HDF"
LONGER = settings(
    max_examples=EXAMPLES,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.generate],
    derandomize=EXAMPLES < 100,
    database=None,
)


def held(*calls):
    """Each call reads, or refuses in one line, soon and without a flood of memory."""
    for call in calls:
        begun, peak = spent(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        said = "expected"
        try:
            call()
        except MocapCalibError as error:
            said = str(error)
        assert "expected" in said
        assert "\n" not in said
        assert len(said) < 1500
        assert (spent() - begun < (SECONDS, CLOCK)).all()
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < MEMORY


def damaged(data, content, folder):
    """The content, damaged by what it is: a tree, a store, text or bytes."""
    rng = random.Random(data.draw(st.integers(0, 2**63)))
    if content.startswith(HDF5):
        (folder / "x").write_bytes(content)
        return damage_hdf5(folder / "x", rng) if rng.random() < 0.7 else damage_bytes(content, rng)
    if content.startswith(b"{") and rng.random() < 0.5:
        return damage_json(json.loads(content), rng).encode("utf-8", "surrogatepass")
    return data.draw(corrupted(content)) if rng.random() < 0.8 else damage_bytes(content, rng)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize("name", WRITTEN)
@LONGER
@given(data=st.data())
def test_damaged_cameras_are_read_or_refused(folder, name, data):
    files = dict(format_rig(studio(name), name, {"seed": 1}).files)
    victim = data.draw(st.sampled_from(sorted(files)))
    files[victim] = damaged(data, files[victim], folder)
    whole, form = Source("folder", files, folder=True), find_format(CAMERA_FORMATS, name)
    together = form.folder and len(files) > 1 and form.sniff(whole)
    held(
        lambda: parse_content(files[victim], victim),
        lambda: parse_content(files[victim], victim, name),
        *([lambda: form.read(whole)] if together else []),
    )


@pytest.mark.parametrize("name", HERE)
@LONGER
@given(data=st.data())
def test_damaged_poses_are_read_or_refused(folder, name, data):
    files = format_poses(example(1), name, Path("x")).files
    content = damaged(data, files["x"], folder)
    held(lambda: parse_poses(content, "x"), lambda: parse_poses(content, "x", name))
