"""The command `filter`: poses of any format in, filtered poses out."""

import numpy as np
import pytest

from mocap_calib.io.poses.common import PoseFile, bare_poses
from mocap_calib.io.poses.read import load_poses
from mocap_calib.io.poses.write import write_poses


@pytest.fixture
def noisy(tmp_path):
    positions = np.random.default_rng(0).normal(size=(60, 2, 3, 3))
    poses = bare_poses(("a", "b", "c"), np.arange(60), positions, unit="m")
    write_poses(tmp_path / "noisy.npz", PoseFile(poses), "npz")
    return tmp_path / "noisy.npz"


@pytest.mark.parametrize(
    ("output", "options"),
    [
        ("out.h5", ("--fps", 60, "--cutoff", 5)),
        ("out.npz", ("--method", "median", "--window", 5)),
        ("out.npz", ("--method", "savgol")),
    ],
)
def test_filters(tool, noisy, tmp_path, output, options):
    said = tool("filter", noisy, "-o", tmp_path / output, *options)
    assert (said.returncode, said.stderr) == (0, "")
    found, given = load_poses(tmp_path / output), load_poses(noisy)
    assert found.poses.positions.std() < 0.8 * given.poses.positions.std()
    assert found.poses.keypoints == given.poses.keypoints


@pytest.mark.parametrize(
    ("options", "status", "says"),
    [
        ((), 1, "give --fps"),
        (("--method", "median", "--window", 4), 2, "expected an odd number, found 4"),
        (("--order", 3, "--fps", 60), 2, "expected an even number, found 3"),
    ],
)
def test_what_cannot_be_filtered_is_refused_in_one_line(
    tool, noisy, tmp_path, options, status, says
):
    said = tool("filter", noisy, "-o", tmp_path / "out.h5", *options)
    assert said.returncode == status
    assert says in said.stderr.splitlines()[-1]
    assert not (tmp_path / "out.h5").exists()
