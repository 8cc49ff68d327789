"""COLMAP's models through pycolmap: its own lenses, rigs, points and tracks are ours, and back; cut
and hostile models end in a line.
"""

import struct
from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras.colmap_model import silent_colmap
from mocap_calib.io.cameras.common import COLMAP_LENSES
from mocap_calib.io.cameras.read import load_cameras, make_rig
from mocap_calib.io.cameras.write import format_rig, write_cameras
from mocap_calib.io.conversion import convert_cameras
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, CameraRig

PARAMETERS = {
    "SIMPLE_PINHOLE": [500, 321.25, 240.5],
    "PINHOLE": [500, 510, 321.25, 240.5],
    "SIMPLE_RADIAL": [500, 321.25, 240.5, -0.1],
    "RADIAL": [500, 321.25, 240.5, -0.1, 0.02],
    "OPENCV": [500, 510, 321.25, 240.5, -0.1, 0.02, 1e-3, -2e-3],
    "FULL_OPENCV": [500, 510, 321.25, 240.5, -0.1, 0.02, 1e-3, -2e-3, 1e-3, 0.01, 2e-3, 1e-4],
    "OPENCV_FISHEYE": [500, 510, 321.25, 240.5, 0.02, -0.01, 2e-3, 1e-3],
    "SIMPLE_RADIAL_FISHEYE": [500, 321.25, 240.5, 0.02],
    "RADIAL_FISHEYE": [500, 321.25, 240.5, 0.02, -0.01],
}
POINTS = np.random.default_rng(0).uniform(-1, 1, (40, 3)) + [0, 0, 6]


def their_model(lenses=tuple(COLMAP_LENSES)):
    """A model that pycolmap made: an image for each lens, of every second point and of its own."""
    model = pycolmap.Reconstruction()
    tracks = [pycolmap.Track() for _ in POINTS]
    for k, lens in enumerate(lenses):
        number = 10 + k
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(
                camera_id=number, model=lens, width=640, height=480, params=PARAMETERS[lens]
            )
        )
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(matrix_from_vector(np.array([0.02 * k, 0.1, -0.03 * k]))),
            [0.1 * k, -0.2, 0.3],
        )
        seen = np.flatnonzero(np.arange(len(POINTS)) % 2 == k % 2)
        ideal = [model.cameras[number].img_from_cam(pose * POINTS[n]) for n in seen]
        image = pycolmap.Image(
            name=f"{lens}.png", keypoints=np.array(ideal), camera_id=number, image_id=number
        )
        model.add_image_with_trivial_frame(image, pose)
        for place, n in enumerate(seen):
            tracks[n].add_element(number, place)
    for point, track in zip(POINTS, tracks, strict=True):
        model.add_point3D(point, track)
    return model


def in_views(rig, points):
    """`[view, N, 2]` pixels of `[N, 3]` points."""
    return np.stack(
        [
            pixels_from_points(camera, points @ rig.rotation[v].T + rig.translation[v])
            for v, camera in enumerate(rig.cameras)
        ]
    )


def rig_of_three():
    matrix = np.array([[1000.0, 0, 640], [0, 1010, 360], [0, 0, 1]])
    lenses = (
        (np.array([-0.1, 0.02, 1e-3, -2e-3, 0.0]), False),
        (np.array([-0.1, 0.02, 1e-3, -2e-3, 1e-3, 0.1, 0.2, 0.3]), False),
        (np.array([0.02, -0.01, 2e-3, 1e-3]), True),
    )
    cameras = tuple(
        Camera(f"cam {k}", (1280, 720), matrix, lens, fisheye)
        for k, (lens, fisheye) in enumerate(lenses)
    )
    turns = matrix_from_vector(np.array([[0.02, 0.1 * k, 0.05] for k in range(3)]))
    return CameraRig(cameras, turns, np.tile([0.1, -0.2, 1.0], (3, 1)), "m")


def observed(rig):
    """The points as the views see them, but the first in two views alone."""
    view, point = np.nonzero(np.ones((len(rig.cameras), len(POINTS)), dtype=bool))
    kept = (view > 0) | (point > 0)
    view, point = view[kept], point[kept]
    return ObservedPoints(POINTS, view, point, in_views(rig, POINTS)[view, point])


@pytest.mark.parametrize("kind", ["binary", "text"])
def test_its_own_models_are_read_with_all_lenses_and_observations(kind, tmp_path):
    """1e-9 px, as the half pixel is ours (measured 3e-13); 9 images of 20 points."""
    model = their_model()
    (model.write_binary if kind == "binary" else model.write_text)(tmp_path)
    found = load_cameras(tmp_path)
    rig = make_rig(found, "x")
    assert rig.names == tuple(COLMAP_LENSES) == tuple(PARAMETERS)
    assert [camera.fisheye for camera in rig.cameras] == list(COLMAP_LENSES.values())
    points = found.points
    np.testing.assert_array_equal(points.positions, POINTS)
    assert np.bincount(points.view).tolist() == [20] * 9
    assert np.bincount(points.point).tolist() == [5, 4] * 20
    ours = in_views(rig, points.positions)[points.view, points.point]
    np.testing.assert_allclose(ours, points.pixels, rtol=0, atol=1e-9)


def test_a_rig_of_two_sensors_is_two_cameras(tmp_path):
    """Newer models place a camera within a rig, and the rig in the world."""
    model = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    sensor = pycolmap.Rigid3d(pycolmap.Rotation3d(), [1.0, 0, 0])
    world = pycolmap.Rigid3d(
        pycolmap.Rotation3d(matrix_from_vector(np.array([0, 0.5, 0]))), [0, 0, 3.0]
    )
    frame = pycolmap.Frame(frame_id=1, rig_id=1)
    for k in (1, 2):
        camera = pycolmap.Camera(
            camera_id=k, model="PINHOLE", width=640, height=480, params=PARAMETERS["PINHOLE"]
        )
        model.add_camera(camera)
        if k == 1:
            rig.add_ref_sensor(camera.sensor_id)
        else:
            rig.add_sensor(camera.sensor_id, sensor)
        image = pycolmap.Image(name=f"{k}.png", camera_id=k, image_id=k)
        frame.add_data_id(image.data_id)
    model.add_rig(rig)
    frame.rig_from_world = world
    model.add_frame(frame)
    for k in (1, 2):
        model.add_image(pycolmap.Image(name=f"{k}.png", camera_id=k, image_id=k, frame_id=1))
    model.register_frame(1)
    model.write_binary(tmp_path)
    found = make_rig(load_cameras(tmp_path), "x")
    np.testing.assert_allclose(found.translation, [[0, 0, 3], [1, 0, 3]], atol=1e-15)
    np.testing.assert_allclose(found.rotation[0], found.rotation[1], atol=1e-15)


@pytest.mark.parametrize("name", ["colmap", "colmap-binary"])
def test_it_reads_our_points_and_tracks(name, tmp_path):
    """Every observation is in a track, where pycolmap itself projects its point: 1e-9 px (measured
    2e-13); the text keeps the unit.
    """
    rig = rig_of_three()
    if name == "colmap":
        cameras = [replace(camera, name=camera.name.replace(" ", "_")) for camera in rig.cameras]
        rig = replace(rig, cameras=tuple(cameras))
    points = observed(rig)
    lost = write_cameras(tmp_path / "m", rig, name, {}, points)
    assert ("the unit of length" in lost) == (name == "colmap-binary")
    assert any("frame, individual and keypoint" in what for what in lost)
    model = pycolmap.Reconstruction(tmp_path / "m")
    assert model.num_points3D() == len(POINTS)
    assert model.compute_num_observations() == len(points.view)
    assert sorted(model.point3D(k).track.length() for k in model.points3D)[:2] == [2, 3]
    assert all(0 <= point.error < 1e-9 for point in model.points3D.values())
    for image in model.images.values():
        for seen in image.points2D:
            there = image.project_point(model.points3D[seen.point3D_id].xyz)
            np.testing.assert_allclose(there, seen.xy, rtol=0, atol=1e-9)
    back = load_cameras(tmp_path / "m")
    assert back.unit == ("m" if name == "colmap" else "arbitrary")
    np.testing.assert_array_equal(back.points.positions, points.positions)
    np.testing.assert_array_equal(back.points.view, points.view)
    np.testing.assert_array_equal(back.points.point, points.point)
    np.testing.assert_allclose(back.points.pixels, points.pixels, rtol=0, atol=1e-12)


def test_points_go_from_one_model_to_the_other_and_are_said_to_be_lost(tmp_path):
    their_model(("OPENCV", "OPENCV_FISHEYE")).write_binary(tmp_path)
    text = convert_cameras(tmp_path, tmp_path / "text", "colmap")
    assert any("frame, individual" in what for what in text.lost)
    one, other = load_cameras(tmp_path), load_cameras(tmp_path / "text")
    np.testing.assert_array_equal(one.points.positions, other.points.positions)
    np.testing.assert_array_equal(one.points.point, other.points.point)
    assert convert_cameras(tmp_path, None, "anipose").lost == ("40 3D points",)


def change(kind):
    """What a damage does to the content of a file."""
    return {
        "count": lambda content: struct.pack("<Q", 2**40) + content[8:],
        "cut": lambda content: content[: len(content) // 2 + 3],
        "end": lambda content: content[:-5],
        "empty": lambda content: content[:0],
        "longer": lambda content: content + b"x",
    }[kind]


@pytest.mark.parametrize("file", ["cameras", "images", "points3D", "rigs", "frames"])
def test_cut_and_hostile_binary_models_end_in_a_line(file, tmp_path):
    """COLMAP reads on behind the end of a file, and fills memory by counts that are not true."""
    their_model(("OPENCV", "OPENCV_FISHEYE")).write_binary(tmp_path)
    path = tmp_path / f"{file}.bin"
    whole = path.read_bytes()
    for kind in ("count", "cut", "end", "empty", "longer"):
        path.write_bytes(change(kind)(whole))
        with pytest.raises(FormatError, match=r"expected .*, found .*; .*") as caught:
            load_cameras(tmp_path)
        assert "\n" not in str(caught.value)
        assert str(tmp_path) in str(caught.value)
    path.write_bytes(whole)
    assert len(load_cameras(tmp_path).cameras) == 2


def test_cameras_alone_are_read_by_their_numbers(tmp_path):
    their_model(("OPENCV", "RADIAL")).write_binary(tmp_path)
    for path in tmp_path.iterdir():
        if path.name != "cameras.bin":
            path.unlink()
    found = load_cameras(tmp_path)
    assert [camera.name for camera in found.cameras] == ["10", "11"]
    assert not found.extrinsics


def test_names_with_spaces_are_for_the_binary_model():
    rig = rig_of_three()
    assert format_rig(rig, "colmap-binary", {}).files.keys() == {
        f"{name}.bin" for name in ("cameras", "images", "points3D", "rigs", "frames")
    }
    with pytest.raises(MismatchError, match="no spaces"):
        format_rig(rig, "colmap", {})


def test_the_log_level_of_the_process_that_writes_and_reads_stays(tmp_path):
    """It is the user's, who may use pycolmap as well."""
    before = pycolmap.logging.minloglevel
    write_cameras(tmp_path / "model", rig_of_three(), "colmap-binary")
    load_cameras(tmp_path / "model")
    with silent_colmap():
        assert pycolmap.logging.minloglevel == int(pycolmap.logging.FATAL)
    assert pycolmap.logging.minloglevel == before < int(pycolmap.logging.FATAL)
