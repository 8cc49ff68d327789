"""The records: what they hold, how they compare and print, and what a rig does with points."""

import sys
import warnings
from dataclasses import replace

import cv2
import h5netcdf
import numpy as np
import pytest
from scenes import scene

import mocap_calib as mc
from mocap_calib.results import PairwiseCalibration

MATRIX = [[1000, 0, 640], [0, 1010, 360], [0, 0, 1]]
UNIT = np.eye(3).tolist()


def camera(name="cam1", **changes) -> mc.Camera:
    return replace(mc.Camera(name, [1280, 720], MATRIX), **changes)


def poses(**changes) -> mc.Poses3D:
    quality = np.ones((2, 1, 2))
    positions = np.arange(12.0).reshape(2, 1, 2, 3)
    positions[0, 0, 0] = np.nan
    made = mc.Poses3D(["nose", "tail"], [5, 6], positions, quality, 2 * quality, quality, "m")
    return replace(made, **changes)


# --- lists, equality, text


def test_lists_become_arrays():
    made = camera()
    assert (made.matrix.dtype, made.matrix.shape) == (np.float64, (3, 3))
    assert made.size == (1280, 720)
    assert not made.distortion.any()
    rig = mc.CameraRig([made], [UNIT], [[0, 0, 1]])
    assert (rig.names, rig.unit, rig.translation.tolist()) == (("cam1",), "arbitrary", [[0, 0, 1]])
    assert poses().views.dtype == np.int64


def test_covariances_of_points_scale_with_the_square_and_may_be_unknown():
    assert np.isnan(poses().covariance).all()
    assert np.isnan(poses().sigma).all()
    known = poses(covariance=np.tile([4.0, 0, 0, 9, 0, 3], (2, 1, 2, 1)))
    assert known.covariance.shape == (2, 1, 2, 6)
    np.testing.assert_allclose(known.sigma, 4.0)
    scaled = known.scale(1000.0, "mm")
    assert scaled.covariance.dtype == np.float32
    np.testing.assert_allclose(scaled.covariance, 1e6 * known.covariance)
    turned = known.turn(np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]))
    np.testing.assert_allclose(turned.covariance[0, 0, 0], [9, 0, 0, 3, 0, 4], atol=1e-6)


def test_arrays_are_kept_as_they_are():
    """No copies of whole recordings; 32 bits stay. Cameras and rigs have arrays of their own."""
    matrix, translation = np.eye(3), np.zeros((1, 3))
    made = camera(matrix=matrix)
    rig = mc.CameraRig([made], [UNIT], translation)
    matrix[0, 0], translation[0, 0] = 9, 9
    assert (made.matrix[0, 0], rig.translation[0, 0]) == (1, 0)
    recording = mc.Recording.from_keypoints(scene().files, scene().rig)
    assert recording.positions.dtype == np.float32
    assert replace(recording, model="none").positions is recording.positions


WRONG = {
    "camera cam1: matrix": lambda: camera(matrix=[1, 2, 3]),
    "matrix: expected numbers": lambda: camera(matrix=[[1, 2], [3]]),
    "distortion: expected at most 8": lambda: camera(distortion=np.full(14, 0.1)),
    "rig: translation": lambda: mc.CameraRig([camera()], [UNIT], [0, 0, 1]),
    "rig: cameras": lambda: mc.CameraRig([camera(), camera()], [UNIT] * 2, np.eye(3)[:2]),
    "rig: unit": lambda: two_views().scale(1, "parsec"),
    "rig: factor: expected a number above 0, got nan": lambda: two_views().scale(np.nan, "m"),
    "rig: factor": lambda: two_views().scale(0, "m"),
    "poses: factor": lambda: poses().scale(-1, "m"),
    "poses: unit": lambda: poses(unit="ell"),
    "poses: covariance": lambda: poses(covariance=np.zeros((2, 1, 2, 3))),
    "poses: frames": lambda: poses(frames=[0.5, 1]),
    "frames: expected whole": lambda: poses(frames=[np.nan, 1]),
    "views": lambda: two_views().select([True] * 3),
    "keypoints": lambda: of_arrays(keypoints=["nose"] * 4),
    "keypoints: expected a list": lambda: of_arrays(keypoints="nose"),
    "positions": lambda: of_arrays(keypoints=["nose", "left_ear", "right_ear"]),
    "frames: expected numbers that ascend": lambda: of_arrays(frames=[0] * 5),
    "frames": lambda: of_arrays(frames=[4, 3, 2, 1, 0]),
    "cameras": lambda: of_arrays(cameras=[camera()] * 2),
    "fps": lambda: poses().to_xarray(fps=0),
    "1 names": lambda: poses().to_xarray(individuals=["a", "b"]),
    "matches: labels": lambda: mc.Matches([[0, 1]]),
    "points": lambda: two_views().project([[1, 2]]),
    "pixels": lambda: two_views().triangulate([[1, 2]]),
    "confidence": lambda: two_views().triangulate([[1, 2]] * 2, [1, 2, 3]),
}


@pytest.mark.parametrize(("owner", "make"), WRONG.items(), ids=WRONG)
def test_what_is_wrong_is_said_in_a_line_with_its_name(owner, make):
    with pytest.raises(ValueError, match=r"expected (.*got |numbers that ascend)") as raised:
        make()
    assert owner in str(raised.value)
    assert "\n" not in str(raised.value)


def test_records_compare_by_value():
    assert camera() == camera()
    assert camera() != camera("cam2")
    assert camera() != camera(fisheye=True)
    rig = scene().rig
    assert rig == replace(rig, rotation=rig.rotation.copy())
    assert rig != replace(rig, translation=rig.translation + 1e-9)
    assert rig != rig.select(rig.names[:2])
    assert rig != "rig"


def test_missing_equals_missing():
    assert poses() == poses()
    assert poses() != poses(positions=np.nan_to_num(poses().positions))
    first, second = scene().files[:2]
    assert first == replace(first, positions=first.positions.copy(), missing={"(0, 0)": 1})
    assert first != second
    pair = PairwiseCalibration(0, 1, np.eye(3), np.ones(3), np.empty((0, 3)), 9, 0, np.nan, 0, "")
    assert pair == replace(pair, residual=float("nan"))
    assert pair != replace(pair, residual=0.1)


def test_records_print_in_short():
    rig = mc.CameraRig([camera(), camera("cam2", fisheye=True)], [UNIT] * 2, np.eye(3)[:2], "m")
    assert repr(rig).splitlines() == [
        "CameraRig of 2 cameras, lengths in m",
        "  cam1: 1280 x 720, f 1005.0 px, no distortion, at (-1, 0, 0)",
        "  cam2: 1280 x 720, f 1005.0 px, fisheye, at (0, -1, 0)",
    ]
    assert repr(mc.Matches(np.zeros((2, 3, 1), int))) == "Matches(labels=int64[2, 3, 1])"
    made = scene()
    recording = mc.Recording.from_keypoints(made.files, made.rig)
    for record in (camera(), made, made.files[0], recording):
        assert len(repr(record)) < 1000  # no array is written out
        assert "\n" not in repr(record)


# --- a recording of arrays


def test_arrays_make_the_recording_that_files_make():
    made = scene()
    found = made.detections
    of_arrays = mc.Recording.from_arrays(
        found.positions, found.confidence, keypoints=found.keypoints, cameras=made.rig
    )
    assert of_arrays == mc.Recording.from_keypoints(made.files, made.rig.cameras)


def test_a_single_subject_needs_no_axis_of_instances():
    alone = of_arrays(frames=range(3, 8))
    assert alone.tracked.all()
    assert alone.frames.tolist() == [3, 4, 5, 6, 7]
    np.testing.assert_array_equal(alone.confidence, np.isfinite(alone.positions[..., 0]))
    assert np.isnan(alone.positions[0, 1, 0, 2]).all()
    assert np.nanmax(of_arrays(confidence=np.full((2, 5, 4), 0.5)).confidence) == 0.5


def of_arrays(**changes) -> mc.Recording:
    """A recording of one subject in two views and five frames; a point is missing."""
    positions = np.random.default_rng(0).uniform(100, 600, size=(2, 5, 4, 2))
    positions[0, 1, 2] = np.nan
    names = ["nose", "left_ear", "right_ear", "tail_base"]
    arguments = {"keypoints": names, "cameras": [camera("a"), camera("b")], **changes}
    return mc.Recording.from_arrays(positions, **arguments)


# --- a camera of a rig


def two_views() -> mc.CameraRig:
    """Two cameras a metre apart that look along z."""
    return mc.CameraRig([camera("a"), camera("b")], [UNIT] * 2, [[0, 0, 0], [-1, 0, 0]], "m")


def test_a_camera_of_a_rig_is_as_opencv_has_it():
    made = scene(distortion="brown")
    points = made.poses[0, 0]
    found = made.rig["cam2"]
    expected, _ = cv2.projectPoints(points, found.rvec, found.tvec, found.matrix, found.distortion)
    np.testing.assert_allclose(made.rig.project(points)[1], expected[:, 0], atol=1e-8)
    np.testing.assert_allclose(found.centre, made.rig.centres[1], atol=1e-12)
    np.testing.assert_allclose(cv2.Rodrigues(found.rvec)[0], found.rotation, atol=1e-12)
    assert [each.name for each in made.rig] == list(made.rig.names)
    assert len(made.rig) == 4
    np.testing.assert_array_equal(made.rig.rvec[1], found.rvec)
    with pytest.raises(KeyError, match=r"expected one of the cameras cam1, cam2, .* found 'cam9'"):
        made.rig["cam9"]


def test_projection_matrices_project():
    rig, point = scene().rig, scene().poses[0, 0, 0]
    images = rig.P @ [*point, 1.0]
    np.testing.assert_allclose(images[:, :2] / images[:, 2:], rig.project(point), atol=1e-9)
    np.testing.assert_array_equal(rig["cam1"].P, rig.P[0])


def test_views_are_chosen_by_name_or_index():
    rig = scene().rig
    assert rig.select(["cam3", "cam1"]) == rig.select(np.array([2, 0]))
    assert rig.select([False, True, False, True]) == rig.select(["cam2", "cam4"])
    assert rig.select("cam2").names == ("cam2",)
    assert ("cam1" in rig, rig["cam1"] in rig, "cam9" in rig) == (True, True, False)
    recording = mc.Recording.from_keypoints(scene().files, rig)
    assert recording.select(views=["cam3", "cam1"]).names == ("cam3", "cam1")
    mask = np.array([False, True, False, True])
    assert recording.select(views=mask) == recording.select(views=np.array([1, 3]))
    for select in (lambda: recording.select(views=["nobody"]), lambda: rig.select(["nobody"])):
        with pytest.raises(KeyError, match="nobody"):
            select()


def test_lengths_get_a_unit():
    rig = scene().rig.scale(100, "cm")
    assert rig.unit == "cm"
    np.testing.assert_allclose(rig.centres, 100 * scene().rig.centres)
    np.testing.assert_allclose(
        rig.project(100 * scene().poses), scene().rig.project(scene().poses), atol=1e-9
    )
    assert np.nanmax(poses().scale(2, "mm").positions) == 22


# --- points and pixels


def test_what_is_behind_a_camera_has_no_pixel():
    pixels = two_views().project([[0, 0, 2], [0, 0, -2], [np.nan, 0, 2]])
    assert pixels[0, 0].tolist() == [640, 360]
    assert np.isnan(pixels[:, 1:]).all()


@pytest.mark.parametrize("distortion", ["none", "brown", "fisheye"])
def test_what_is_projected_is_triangulated(distortion):
    """Measured 2e-13 m, and 2e-10 pixels."""
    rig = scene(distortion=distortion).rig
    points = scene().poses[:5]
    found, error = rig.triangulate(rig.project(points))
    np.testing.assert_allclose(found, points, rtol=0, atol=1e-10)
    assert error.shape == points.shape[:-1]
    assert error.max() < 1e-7


def test_the_error_is_that_of_the_reprojection():
    rig = scene().rig
    points = scene().poses[:3]
    pixels = rig.project(points) + np.random.default_rng(0).normal(size=(4, *points.shape[:-1], 2))
    found, error = rig.triangulate(pixels)
    square = ((rig.project(found) - pixels) ** 2).sum(-1)
    all_used = np.isclose(error, np.sqrt(square.mean(0)))
    assert all_used.mean() > 0.9  # measured 0.98: a view in the others is left out


def test_what_two_views_do_not_see_is_missing():
    rig = scene().rig
    pixels = rig.project(scene().poses[0, 0, :3])
    pixels[1:, 0] = np.nan
    confidence = np.ones((4, 3))
    confidence[:3, 1] = 0
    confidence[0, 2] = np.nan
    pixels[1, 2] = np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, error = rig.triangulate(pixels, confidence)
    assert np.isnan(found[:2]).all()
    assert np.isnan(error[:2]).all()
    np.testing.assert_allclose(found[2], scene().poses[0, 0, 2], atol=1e-9)
    # a hundredth of a degree apart: no depth
    near = mc.CameraRig(two_views().cameras, [UNIT] * 2, [[0, 0, 0], [-1e-4, 0, 0]], "m")
    assert np.isnan(near.triangulate(near.project([0, 0, 3]))[0]).all()


# --- xarray


def test_a_data_set_is_what_the_file_of_movement_holds(tmp_path):
    """The same dimensions, coordinates, values and attributes, with and without a rate."""
    pytest.importorskip("xarray")
    for rate, names in ((25.0, ("ann",)), (None, ())):
        dataset = poses().to_xarray(fps=rate, individuals=names)
        path = tmp_path / "poses.nc"
        mc.write(poses(), path, format="movement-3d", fps=rate, individuals=names)
        with h5netcdf.File(path) as file:
            assert {*dataset.variables} == {*file.variables}
            for name, variable in dataset.variables.items():
                assert variable.dims == file[name].dimensions
                held = file[name][()]
                held = held.astype(str) if held.dtype.kind == "O" else held
                np.testing.assert_array_equal(variable.values, held)
            assert dict(dataset.attrs) == dict(file.attrs)
    assert dataset.position.dims == ("time", "space", "keypoint", "individual")
    assert dataset.position.sel(space="y", keypoint="tail", time=5).item() == 4.0


def test_xarray_is_asked_for_in_a_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(mc.MismatchError, match=r"pip install mocap-calib\[xarray\]"):
        poses().to_xarray()
