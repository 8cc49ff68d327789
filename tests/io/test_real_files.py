"""Real files of other programs: their counts, or the refusal.

MOCAP_CALIB_SAMPLES names their folder. `real_files.tsv` has a row a file. Cameras of keypoints are
name:frames:first-last:most instances at once:keypoints:points; options are the number of names of a
layout, and what else the user says.
"""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import mocap_calib as mc

SAMPLES = Path(os.environ.get("MOCAP_CALIB_SAMPLES", "none"))
pytestmark = pytest.mark.skipif(
    not SAMPLES.is_dir(), reason="MOCAP_CALIB_SAMPLES names no folder of real files"
)
with Path(__file__).with_name("real_files.tsv").open(encoding="utf-8") as table:
    ROWS = list(csv.DictReader(table, delimiter="\t", quoting=csv.QUOTE_NONE))


def options_of(text: str) -> mc.ReadOptions:
    words = dict(word.split("=", 1) for word in text.split())
    return mc.ReadOptions(
        layout=tuple(f"point {k}" for k in range(int(words.get("layout", 0)))),
        camera_pattern=words.get("pattern", ""),
        views=tuple(filter(None, words.get("views", "").split(","))),
        image_size=tuple(map(int, words.get("size", "0x0").split("x"))),
    )


def describe_view(view: mc.Keypoints2D) -> str:
    frames, (instances, keypoints) = view.frames, view.positions.shape[1:3]
    seen = int(np.isfinite(view.positions[..., 0]).sum())
    span = f"{frames[0]}-{frames[-1]}"
    return f"{view.camera}:{len(frames)}:{span}:{instances}:{keypoints}:{seen}"


def describe(kind: str, path: Path, options: str) -> str:
    """Return what is read of a file in the words of the table."""
    if kind == "keypoints":
        return " ".join(map(describe_view, mc.read_keypoints(path, None, options_of(options))))
    if kind == "poses":
        poses = mc.read_poses(path)
        assert np.isfinite(poses.positions).any()
        frames, individuals, keypoints, _ = poses.positions.shape
        return f"{frames} x {individuals} x {keypoints}, {poses.unit}"
    count = f"{len(mc.read_cameras(path))} cameras"
    try:
        return f"{count}, all placed, {mc.read_rig(path).unit}"
    except mc.FormatError:  # extrinsics
        return f"{count}, not all placed"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['kind']} {row['file']}")
def test_a_real_file_has_its_counts_or_is_refused_for_its_reason(row):
    path, outcome = SAMPLES / row["file"], row["outcome"]
    if not outcome.startswith("refused: "):
        assert describe(row["kind"], path, row["options"]) == outcome
        return
    with pytest.raises(mc.FormatError) as refused:
        describe(row["kind"], path, row["options"])
    assert outcome.removeprefix("refused: ") in str(refused.value)
    assert str(path) in str(refused.value)


LILY, PRANAV = "more/dlc_single_lily_cam1", "dlc_labels/CollectedData_Pranav"
BACK, MADE = "sleap_anipose_session/minimal_back_proofread", "dlc_h5_generated/single_table_pd"


@pytest.mark.parametrize(
    ("first", "second", "tolerance"),
    [
        (f"{BACK}.analysis.h5", f"{BACK}.slp", 0.0),
        (f"{BACK}.analysis.h5", "movement_netcdf/sleap_back_2d.nc", 1e-4),  # of 32 bits
        (f"{LILY}.csv", f"{LILY}.h5", 1e-9),
        (f"{PRANAV}.csv", f"{PRANAV}.h5", 1e-9),
        (f"{MADE}3.h5", f"{MADE}135.h5", 0.0),
        *(
            (
                f"dlc_h5_generated/{k}.csv",
                f"dlc_h5_generated/{k.replace('_pd', '_table_pd')}.h5",
                1e-9,
            )
            for k in ("multi_unique_pd3", "single_pd135")
        ),
    ],
)
def test_two_formats_of_one_real_recording_are_equal(first, second, tolerance):
    one, two = (mc.read_keypoints(SAMPLES / name)[0] for name in (first, second))
    assert (one.keypoints, one.tracked) == (two.keypoints, two.tracked)
    np.testing.assert_array_equal(one.frames, two.frames)
    np.testing.assert_allclose(one.positions, two.positions, rtol=0, atol=tolerance)
    np.testing.assert_allclose(one.confidence, two.confidence, rtol=0, atol=max(tolerance, 2e-7))


@pytest.mark.parametrize(
    ("path", "scale", "tolerance"),
    [
        *((name, 1, 1e-9) for name in ("nerfstudio/transforms.json", "openmvg/sfm_data.json")),
        *((name, 1, 1e-9) for name in ("colmap/txt", "colmap/bin")),
        ("jarvis_yaml/cam_01.yaml", 1000, 1e-6),
        ("opencv_yaml/cam_01_cv5.yml", 1, 1e-6),
    ],
)
def test_one_real_rig_is_one_rig_in_all_formats(path, scale, tolerance):
    """Other programs made the samples of the Pose2Sim one; tangential terms are left out."""
    first, found = (
        mc.read_rig(SAMPLES / "pose2sim_toml/Calib_qualisys.toml"),
        mc.read_rig(SAMPLES / path),
    )
    np.testing.assert_allclose(found.rotation[0], first.rotation[0], atol=1e-9)
    np.testing.assert_allclose(found.translation[0], first.translation[0] * scale, atol=tolerance)
    matrices = (rig.cameras[0].matrix[:2, 2] for rig in (found, first))
    np.testing.assert_allclose(*matrices, atol=1e-9 if path[0] in "noc" else 1.0)


def test_voxelpose_and_4d_association_agree_on_the_shelf():
    """Two data sets' files of one rig, rounded to 6 digits: within 1 mm (measured 0.02)."""
    names = ("calibration_shelf.json", "4da_shelf_calibration.json")
    voxel, four = (mc.read_rig(SAMPLES / "panoptic_calib" / name) for name in names)
    np.testing.assert_allclose(voxel.centres, four.centres * 1000, atol=1.0)


def test_real_points_are_seen_where_they_were_clicked():
    """Label3D's own 3D: 0.14 to 0.92 px; hundreds where its matrices are not transposed."""
    path = SAMPLES / "dannce_mat/label3d_dannce.mat"
    rig = mc.read_rig(path)
    for view, cell in enumerate(loadmat(path)["labelData"]):
        label = cell[0][0, 0]
        points, clicked = (label[name].reshape(81, 22, -1) for name in ("data_3d", "data_2d"))
        apart = np.linalg.norm(rig.project(points)[view] - clicked, axis=-1)
        assert np.nanmedian(apart) < 1.5


def test_poses_of_one_real_session_agree():
    """The CSV was made of the h5, with 3 digits less than a double has: 1e-9 of 600 mm."""
    names = ("anipose_csv/points3d_anipose_layout.csv", "sleap_anipose_session/points3d.h5")
    table, store = (mc.read_poses(SAMPLES / name).positions for name in names)
    np.testing.assert_allclose(table, store, rtol=0, atol=6e-7)
