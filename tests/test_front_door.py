"""`import mocap_calib`: quick, and every name of it there."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mocap_calib

HEAVY = ("numpy", "torch", "scipy", "cv2", "h5py", "yaml")


def test_import_is_quick_and_light():
    """Measured 0.001 s on top of the interpreter; the best of three, as other work may run."""
    code = f"""
import sys, time
start = time.perf_counter()
import mocap_calib
seconds = time.perf_counter() - start
print(seconds, [name for name in {HEAVY} if name in sys.modules])
"""
    best = np.inf
    for _ in range(3):
        said = subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True
        ).stdout
        seconds, _, heavy = said.strip().partition(" ")
        assert heavy == "[]"
        best = min(best, float(seconds))
    assert best < 0.1


@pytest.mark.parametrize("name", mocap_calib.__all__)
def test_every_name_resolves(name):
    value = getattr(mocap_calib, name)
    assert value.__name__ == name
    assert value.__doc__, "what users see first says what it is"
    assert name in dir(mocap_calib)


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(mocap_calib.__file__).read_text("utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imported = {
        (alias.name, node.module.removeprefix("mocap_calib."))
        for node in block.body
        for alias in node.names
    }
    assert imported == set(mocap_calib._MODULE_OF.items())
    assert {name for name, _ in imported} == set(mocap_calib.__all__)


@pytest.mark.parametrize(
    ("function", "needed"),
    [
        (mocap_calib.calibrate, ["recording", "lifter"]),
        (mocap_calib.triangulate, ["recording", "rig", "matches"]),
    ],
)
def test_stages_need_nothing_but_data(function, needed):
    parameters = inspect.signature(function).parameters.values()
    assert [each.name for each in parameters if each.default is each.empty] == needed


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="has no attribute 'frobnicate'"):
        _ = mocap_calib.frobnicate


@pytest.mark.slow
def test_a_job_is_a_run(done, small, tmp_path):
    """What `run` does from files to files, without the command line."""
    request = mocap_calib.CalibrationRequest(
        keypoints=mocap_calib.KeypointSource((str(small / "keypoints"),)),
        cameras=(small / "intrinsics.toml").read_bytes(),
        output=tmp_path / "out",
    )
    job = mocap_calib.read_job(request)
    mocap_calib.write_results(job, mocap_calib.calibrate_job(job))
    for name in ("matches.csv", "poses3d_0.csv", "poses3d_1.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (done[0] / name).read_bytes()


@pytest.mark.slow
def test_a_recording_is_calibrated_in_memory(small):
    """Detections to a rig that agrees with the truth; measured 0.1 degrees."""
    views = mocap_calib.read_keypoints([small / "keypoints"])
    cameras = mocap_calib.read_cameras(small / "intrinsics.toml")
    skeleton, aliases = mocap_calib.fit_vocabulary(views[0].keypoints, aliases_file=None)
    recording = mocap_calib.make_recording(views, cameras, skeleton, aliases)
    result = mocap_calib.calibrate(
        recording,
        mocap_calib.load_model(skeleton.name),
        mocap_calib.Config(),
        seed=0,
        device="cpu",
        progress=mocap_calib.silent,
    )
    truth = mocap_calib.read_rig(small / "reference.toml")
    evaluation = mocap_calib.evaluate_rig(result.groups[0].rig, truth)
    assert np.degrees(evaluation.rotation_error).max() < 0.5
