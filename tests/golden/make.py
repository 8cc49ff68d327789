"""Write the golden files anew.

    python tests/golden/make.py                 the outcomes: expected.json and messages.txt
    python tests/golden/make.py corpus          the files of other programs, then the outcomes
    python tests/golden/make.py show CASE       what the digests of a conversion are taken of

Look at `git diff tests/golden` afterwards: each changed line is a change that users see. Where a
digest changed, compare what `show` prints of the two versions of the program.
"""

import json
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "cli"), str(ROOT / "tests")]

from golden import refusals  # noqa: E402 - of the folders above
from golden.cases import (  # noqa: E402
    CORPUS,
    EXPECTED,
    MESSAGES,
    TARGETS,
    Conversion,
    as_block,
    conversions,
    damages,
)
from golden.command import call  # noqa: E402

PLAIN = """format: mocap-calib cameras
version: 1
unit: m
cameras:
- name: left
  size: [1280, 720]
  model: opencv
  K: [[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]]
  distortion: [0.0, 0.0, 0.0, 0.0, 0.0]
  R: [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]
  t: [0.5, 0.25, 4.0]
- name: right
  size: [1280, 720]
  model: opencv
  K: [[950.0, 0.0, 630.0], [0.0, 950.0, 355.0], [0.0, 0.0, 1.0]]
  distortion: [0.0, 0.0, 0.0, 0.0, 0.0]
  R: [[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]
  t: [-0.5, 0.25, 4.5]
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [500.0, 501.0, 320.0, 240.0]
  distortion_model: radtan
  distortion_coeffs: [0.1, -0.02, 0.01, 0.002]
  resolution: [640, 480]
  rostopic: /left
cam1:
  T_cn_cnm1:
  - [0.8, 0.0, 0.6, 0.5]
  - [0.0, 1.0, 0.0, 0.25]
  - [-0.6, 0.0, 0.8, 0.125]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  intrinsics: [510.0, 511.0, 321.0, 241.0]
  distortion_model: equidistant
  distortion_coeffs: [0.1, -0.02, 0.01, 0.002]
  resolution: [640, 480]
  rostopic: /right
"""
ROS = """image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, -0.2, 0.001, 0.002, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [500.0, 0.0, 320.0, 0.0, 0.0, 501.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""


@contextmanager
def scratch() -> Iterator[Path]:
    """Give a folder that is removed afterwards."""
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def convert(folder: Path, source: str, target: Path, form: str, *options: str) -> None:
    """Convert by the command, which must succeed."""
    target.parent.mkdir(parents=True)
    done = call("convert", source, target, "--to", form, *options, folder=folder)
    assert done.status == 0, done.stderr


def make_keypoints() -> None:
    """Write a recording of two subjects as each program that the tests know does."""
    from samples2d import SAMPLES, recording, write_sample

    for name, sample in SAMPLES.items():
        folder = CORPUS / "keypoints" / name.replace(" ", "-")
        write_sample(name, folder, *recording(sample.most, scores=sample.scores))


def make_cameras() -> None:
    """Write three simulated cameras in each format that holds them, and four other rigs."""
    to = CORPUS / "cameras"
    for name, file, text in (
        ("plain", "cameras.yaml", PLAIN),
        ("kalibr", "camchain.yaml", KALIBR),
        ("ros", "left.yaml", ROS),
    ):
        (to / name).mkdir(parents=True)
        (to / name / file).write_text(text, "utf-8", newline="\n")
    with scratch() as folder:
        (folder / "plain.yaml").write_text(PLAIN, "utf-8", newline="\n")
        for lens in ("brown", "fisheye"):
            words = ("--cameras", 3, "--people", 1, "--frames", 2, "--distortion", lens)
            assert call("simulate", "-o", lens, *words, folder=folder).status == 0
        fisheye = to / "anipose-fisheye" / "calibration.toml"
        convert(folder, "fisheye/reference.toml", fisheye, "anipose")
        for form in TARGETS["cameras"]:
            plain = form in ("4d-association", "openmvg")
            source = "plain.yaml" if plain else "brown/reference.toml"
            convert(folder, source, to / form / FILES.get(form, "model"), form)
            if form in FOLDERS:
                flatten(to / form)


# names of camera files as their programs call them; the other formats are folders
FILES = {
    "mocap-calib": "cameras.yaml",
    "4d-association": "calibration.json",
    "anipose": "calibration.toml",
    "caliscope": "camera_array.toml",
    "dannce": "label3d_dannce.mat",
    "freemocap": "calibration.toml",
    "nerfstudio": "transforms.json",
    "openmvg": "sfm_data.json",
    "panoptic": "calibration.json",
    "pose2sim": "Calib.toml",
    "voxelpose": "calibration.json",
}
FOLDERS = set(TARGETS["cameras"]) - set(FILES)


def flatten(folder: Path) -> None:
    """Move what is in the only folder of a folder up."""
    (inner,) = folder.iterdir()
    for path in inner.iterdir():
        path.rename(folder / path.name)
    inner.rmdir()


def make_poses() -> None:
    """Write two bodies of four joints in five frames in each format of poses that is read."""
    rng = np.random.default_rng(1)
    names = ("left_hip", "right_hip", "left_knee", "left_ankle")
    shape = (5, 2, len(names))
    positions = rng.normal(size=(*shape, 3)).round(3)
    positions[1, 0, 0] = positions[3, 1] = np.nan
    seen = np.isfinite(positions[..., 0])
    arrays = {
        "positions": positions,
        "error": np.where(seen, rng.uniform(0.5, 3, shape).round(3), np.nan),
        "views": np.where(seen, 3, 0),
        "confidence": np.where(seen, rng.uniform(0.1, 1, shape).round(3), 0.0),
        "frames": np.array([3, 4, 5, 7, 8]),
        "covariance": rng.uniform(0.001, 0.002, (*shape, 6)).round(6).astype(np.float32),
        "keypoints": np.array(names),
        "individuals": np.array(["anna", "ben"]),
        "fps": np.array(60.0),
        "unit": np.array("m"),
        "title": np.array(""),
    }
    to = CORPUS / "poses"
    (to / "npz").mkdir(parents=True)
    np.savez(to / "npz" / "poses.npz", **arrays)
    for form, file in (
        ("poses-h5", "poses3d.h5"),
        ("anipose-csv", "poses.csv"),
        ("trc", "poses.trc"),
        ("c3d", "poses.c3d"),
        ("movement-3d", "poses.nc"),
        ("sleap-anipose", "points3d.h5"),
    ):
        convert(to, "npz/poses.npz", to / form / file, form)
    make_nwb(to / "nwb-3d", positions[:, 0], names)


def make_nwb(folder: Path, positions: np.ndarray, names: tuple[str, ...]) -> None:
    """Write one body as ndx-pose does, `[frame, keypoint, 3]`."""
    folder.mkdir()
    with h5py.File(folder / "poses.nwb", "w", libver="latest") as file:
        for k, name in enumerate(names):
            series = file.create_group(f"processing/behavior/mouse/{name}")
            series.attrs["neurodata_type"] = "PoseEstimationSeries"
            series["data"] = positions[:, k]
            series["data"].attrs.update({"conversion": 1000.0, "unit": "millimeters"})
            series["starting_time"] = 0.1
            series["starting_time"].attrs["rate"] = 30.0


def make_corpus() -> None:
    """Write all files of the corpus."""
    shutil.rmtree(CORPUS, ignore_errors=True)
    make_keypoints()
    make_cameras()
    make_poses()


def outcome(case: Conversion) -> dict:
    """Return what comes of a case."""
    with scratch() as folder:
        return case.outcome(folder)


def make_outcomes() -> None:
    """Write what comes of all cases."""
    found = {case.name: outcome(case) for case in conversions()}
    rows = (f" {json.dumps(name)}: {json.dumps(each)}" for name, each in found.items())
    EXPECTED.write_text("{\n" + ",\n".join(rows) + "\n}\n", "utf-8", newline="\n")
    blocks = [as_block(case.name, outcome(case)) for case in damages()]
    with scratch() as folder:
        refusals.lay_out(folder)
        blocks += [as_block(name, refusals.outcome(name, folder)) for name in refusals.REFUSALS]
    MESSAGES.write_text("\n\n".join(blocks) + "\n", "utf-8", newline="\n")


def show(name: str) -> None:
    """Print what the digests of a case are taken of."""
    (case,) = (each for each in (*conversions(), *damages()) if each.name == name)
    with scratch() as folder:
        print(case.show(folder))


if __name__ == "__main__":
    warnings.simplefilter("error")
    if sys.argv[1:2] == ["show"]:
        show(" ".join(sys.argv[2:]))
    else:
        if sys.argv[1:] == ["corpus"]:
            make_corpus()
        make_outcomes()
