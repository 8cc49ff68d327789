"""What is particular to one camera format: small files as other programs write them, and numbers.

Files that `convert` reads or refuses are in tests/golden/corpus.
"""

import os
import pickle
import struct
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
from conformance import CORPUS
from golden.command import call
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import mocap_calib as mc

TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
K = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
FLAT = [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]
REFUSED = "expected .+, found .+; .+"


def check(path: Path, expected: str | Mapping[str, Any]) -> None:
    """Read cameras, or a rig where its pose is expected, and compare."""
    if isinstance(expected, str):
        with pytest.raises((mc.FormatError, mc.MismatchError), match=expected) as refused:
            mc.read_rig(path)
        assert "\n" not in str(refused.value)
        assert str(refused.value).startswith(str(path.parent))
        return
    of_rig = {"rotation", "translation", "unit"}
    if set(expected) & of_rig:
        rig = mc.read_rig(path)
        cameras = rig.cameras
    else:
        cameras = mc.read_cameras(path)
    for name, value in expected.items():
        if name == "names":
            assert [each.name for each in cameras] == list(value)
        elif name == "unit":
            assert rig.unit == value
        elif name in of_rig:
            np.testing.assert_allclose(getattr(rig, name)[-1], value, atol=1e-12)
        elif isinstance(getattr(cameras[0], name), np.ndarray):
            np.testing.assert_allclose(getattr(cameras[0], name), value, rtol=0, atol=1e-12)
        else:
            assert getattr(cameras[0], name) == value


LENS = {"matrix": K, "distortion": [0.1, -0.2, 0, 1e-3, 0]}
SEEN = {"size": (640, 480), "fisheye": False, "matrix": K, "distortion": [0.1, -0.2, 0, 1e-3, 0]}


def ros(k="K", d="D") -> str:
    head = "header:\n  seq: 1\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\n"
    return head + f"{d}: [0.1, -0.2, 0.0, 0.001, 0.0]\n{k}: {FLAT}\nR: {[1, 0, 0] * 3}\n---\n"


ROS_INFO = (
    "image_width: 640\nimage_height: 480\ncamera_name: rgb\n"
    f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {FLAT}\ndistortion_model: equidistant\n"
    "distortion_coefficients:\n  rows: 1\n  cols: 4\n  data: [0.1, 0, 0, 0]\n"
)
CASES = {  # of intrinsics alone, which `convert` refuses, and of files that are too large to keep
    "no size": (f"%YAML:1.0\n---\nK: {K}\n", {"size": (0, 0), "distortion": [0] * 5}),
    "rostopic echo": (ros(), SEEN | {"names": ["rig"]}),
    "ros2 topic echo": (ros("k", "d"), SEEN | {"names": ["rig"]}),
    "camera_info": (ROS_INFO, {"names": ["rgb"], "size": (640, 480), "fisheye": True}),
    "too large": ("K: " + "[1]," * 1_100_000, "below 2 MB"),
    "a crowd of values": ("camera_matrix: [" + "1," * 60_000 + "1]\n", "50000 values"),
    "long nothing": (" \n" * 100_000, REFUSED),
    **{
        f"the lens under {key}": (f"mtx: {FLAT}\n{key}: [0.1, -0.2, 0, 0.001, 0]\n", LENS)
        for key in (
            *("dist", "distCoeffs", "distortion", "distortion_coeffs", "kc", "D", "dist_coef"),
            *("Distortion_Coefficients", "distortionParameters", "DistCoeff", "lens_distortion"),
        )
    },
    **{
        f"the matrix under {key}": (f"{key}: {FLAT}\ndist: [0.1, -0.2, 0, 0.001, 0]\n", LENS)
        for key in ("cameraMatrix", "Camera_Matrix", "K", "intrinsic_matrix", "cam_mtx", "camera_K")
    },
    **{
        f"a fisheye by {flag}": (f"K: {FLAT}\n{flag}\nD: [0.1, 0, 0, 0]\n", {"fisheye": True})
        for flag in (
            *("fisheye_model: 1", "camera_model: fisheye", "is_fisheye: true", "fisheye: 1"),
            *("lens_type: fisheye", "model: OPENCV_FISHEYE", "distortion_model: kannala_brandt4"),
        )
    },
    "no fisheye": (f"K: {FLAT}\nfisheye_model: 0\nmodel: opencv\n", {"fisheye": False}),
    "coefficients one by one": (
        "size: [640, 480]\nfx: 500\nfy: 501\ncx: 320\ncy: 240\nk1: 0.1\nk2: -0.2\np2: 0.001\n",
        SEEN | {"distortion": [0.1, -0.2, 0, 1e-3]},
    ),
    "MATLAB's coefficients": (
        f"K: {FLAT}\nRadialDistortion: [0.1, -0.2]\nTangentialDistortion: [0, 0.001]\n",
        {"distortion": [0.1, -0.2, 0, 1e-3]},
    ),
    "poses of a board": (
        f"img_shape: [480, 640, 3]\nmtx: {FLAT}\nrvecs: {[[1, 2]] * 7}\ntvecs: {[[1, 2]] * 7}",
        {"size": (640, 480)},
    ),
    "JSON": (f'{{"camera_matrix": {K}, "dist": [[0.1, -0.2, 0, 0.001, 0]]}}', LENS),
    "deep nothing": ("[" * 200_000, REFUSED),
    "one word": ("a" * 1_000_000, REFUSED),
}


@pytest.mark.parametrize(("text", "expected"), CASES.values(), ids=CASES)
def test_a_detail_is_read_or_refused(text, expected, tmp_path):
    (tmp_path / "rig.yaml").write_text(text)
    check(tmp_path / "rig.yaml", expected)


def test_dannce_s_files_of_one_camera_each_are_a_rig(tmp_path):
    """Matrices are for row vectors; the names are in those of the files."""
    for name in ("a", "b"):
        fields = {"K": np.transpose(K), "RDistort": [0.1, 0.2, 0.3], "TDistort": [0.01, 0.02]}
        place = {"r": TURN.T, "t": np.array([[1.0, 2, 3]])}
        savemat(tmp_path / f"hires_{name}_params.mat", fields | place)
    expected = {"names": ["a", "b"], "matrix": K, "distortion": [0.1, 0.2, 0.01, 0.02, 0.3]}
    check(tmp_path, expected | {"unit": "mm", "rotation": TURN, "translation": [1, 2, 3]})
    whole = (tmp_path / "hires_a_params.mat").read_bytes()
    for end in (len(whole) - 1, len(whole) - 16):
        (tmp_path / "hires_a_params.mat").write_bytes(whole[:end])
        check(tmp_path, REFUSED)
    (tmp_path / "no").mkdir()
    savemat(tmp_path / "no" / "x.mat", {"K": np.eye(3)})
    check(tmp_path / "no" / "x.mat", "give the file that has the cameras")


# --- COLMAP's models by pycolmap

PARAMETERS = {  # half a pixel more than ours
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


def their_model(lenses=tuple(PARAMETERS)) -> pycolmap.Reconstruction:
    """Return a model of an image for each lens, of every second point."""
    model, tracks = pycolmap.Reconstruction(), [pycolmap.Track() for _ in POINTS]
    for k, name in enumerate(lenses):
        camera = pycolmap.Camera(
            camera_id=10 + k, model=name, width=640, height=480, params=PARAMETERS[name]
        )
        model.add_camera_with_trivial_rig(camera)
        turn = Rotation.from_rotvec([0.02 * k, 0.1, -0.03 * k]).as_matrix()
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), [0.1 * k, -0.2, 0.3])
        seen = np.flatnonzero(np.arange(len(POINTS)) % 2 == k % 2)
        ideal = np.array([camera.img_from_cam(pose * POINTS[n]) for n in seen])
        image = pycolmap.Image(
            name=f"{name}.png", keypoints=ideal, camera_id=10 + k, image_id=10 + k
        )
        model.add_image_with_trivial_frame(image, pose)
        for place, n in enumerate(seen):
            tracks[n].add_element(10 + k, place)
    for point, track in zip(POINTS, tracks, strict=True):
        model.add_point3D(point, track)
    return model


@pytest.mark.parametrize("kind", ["binary", "text"])
def test_colmap_s_models_are_read_with_all_lenses_points_and_tracks(kind, tmp_path):
    """Also through a conversion; 1e-9 px (measured 3e-13), as the half pixel is ours."""
    (tmp_path / "model").mkdir()
    getattr(their_model(), f"write_{kind}")(tmp_path / "model")
    before = pycolmap.logging.minloglevel
    rig = mc.read_rig(tmp_path / "model")
    assert rig.names == tuple(PARAMETERS)
    assert [each.name for each in rig.cameras if each.fisheye] == list(PARAMETERS)[6:]
    ours = rig.project(POINTS)
    for target in ("colmap", "colmap-binary"):
        done = call(
            "convert", "model", target, "--to", target, "--input-unit", "m", folder=tmp_path
        )
        assert done.status == 0
        back = pycolmap.Reconstruction(tmp_path / target)
        assert back.num_points3D() == len(POINTS)
        assert back.compute_num_observations() == 9 * 20
        assert sorted(each.track.length() for each in back.points3D.values()) == [4] * 20 + [5] * 20
        for image in back.images.values():
            v = rig.names.index(image.name.removesuffix(".png"))
            for seen in image.points2D:
                point = back.points3D[seen.point3D_id].xyz
                np.testing.assert_allclose(image.project_point(point), seen.xy, rtol=0, atol=1e-9)
                (n,) = np.flatnonzero((point == POINTS).all(-1))
                np.testing.assert_allclose(ours[v, n], seen.xy - 0.5, rtol=0, atol=1e-9)
    done = call("convert", "model", "out.toml", folder=tmp_path)
    assert "40 3D points" in "\n".join(done.stderr)
    assert pycolmap.logging.minloglevel == before, "the log level is the user's"


@pytest.mark.parametrize("file", ["cameras", "images", "points3D", "rigs", "frames"])
def test_cut_and_hostile_binary_models_end_in_a_line(file, tmp_path):
    """COLMAP reads on behind the end of a file, and fills memory by counts that are not true."""
    their_model(("OPENCV", "OPENCV_FISHEYE")).write_binary(tmp_path)
    path = tmp_path / f"{file}.bin"
    whole = path.read_bytes()
    changes = [struct.pack("<Q", 2**40) + whole[8:], whole[: len(whole) // 2 + 3]]
    for content in (*changes, whole[:-5], b"", whole + b"x"):
        path.write_bytes(content)
        check(tmp_path, REFUSED)
    path.write_bytes(whole)
    assert len(mc.read_cameras(tmp_path)) == 2


def test_colmap_s_cameras_alone_are_read_by_their_numbers(tmp_path):
    their_model(("OPENCV", "RADIAL")).write_binary(tmp_path)
    for path in tmp_path.iterdir():
        if path.name != "cameras.bin":
            path.unlink()
    assert [camera.name for camera in mc.read_cameras(tmp_path)] == ["10", "11"]


def test_names_with_spaces_are_for_the_binary_model(tmp_path):
    camera = mc.Camera("cam 1", (640, 480), np.array(K), np.zeros(5))
    rig = mc.CameraRig((camera,), np.eye(3)[None], np.zeros((1, 3)), "m")
    mc.write(rig, tmp_path / "binary", "colmap-binary")
    names = {f"{name}.bin" for name in ("cameras", "images", "points3D", "rigs", "frames")}
    assert {path.name for path in (tmp_path / "binary").iterdir()} == names
    with pytest.raises(mc.MismatchError, match="no spaces"):
        mc.write(rig, tmp_path / "text", "colmap")


def test_a_number_beyond_floats_in_our_own_file_is_not_known(tmp_path):
    camera = mc.Camera("a", (640, 480), np.array(K), np.zeros(5))
    rig = mc.CameraRig((camera,), np.eye(3)[None], np.zeros((1, 3)), "m")
    path = tmp_path / "cameras.yaml"
    mc.write(rig, path)
    huge = "1" + 400 * "0"
    path.write_text(
        f"world: {{kind: floor, floor_sigma: {huge}}}\n{path.read_text('utf-8')}", "utf-8"
    )
    assert np.isnan(mc.read_rig(path).world.floor_sigma)


# --- DLT coefficients, Vicon, OpenCap


def flat_rig() -> mc.CameraRig:
    rig = mc.read_rig(CORPUS / "cameras" / "mocap-calib")
    cameras = [replace(camera, distortion=np.zeros(5)) for camera in rig.cameras]
    return replace(rig, cameras=tuple(cameras))


def test_dlt_coefficients_come_back_and_those_of_mirrored_images_are_refused(tmp_path):
    """Where the origin lies behind one of the cameras, too."""
    rig = flat_rig()
    behind = replace(rig, translation=rig.translation * [[1, 1, -1], [1, 1, 1], [1, 1, 1]])
    for each in (rig, behind):
        lost = mc.write(each, tmp_path / "dlt.csv", "dlt")
        assert [what.split()[-1] for what in lost] == ["length", "sizes"]
        found = mc.read_rig(tmp_path / "dlt.csv")
        np.testing.assert_allclose(found.rotation, each.rotation, atol=1e-9)
        np.testing.assert_allclose(found.translation, each.translation, atol=1e-9)
    height = 720.0
    table = np.loadtxt(tmp_path / "dlt.csv", delimiter=",")
    below = np.vstack([table[8:], np.ones((1, 3))])
    table[4:8] = height * below - table[4:8]
    np.savetxt(tmp_path / "up.csv", table[:, 1:], delimiter=",")
    check(tmp_path / "up.csv", "expected coefficients of images whose v points down.*flip them")
    tilted = replace(rig.cameras[0], distortion=np.array([0.1, 0, 0, 0, 0]))
    with pytest.raises(mc.MismatchError, match="distortion"):
        mc.write(replace(rig, cameras=(tilted, *rig.cameras[1:])), tmp_path / "x.csv", "dlt")


def test_easywand_s_coefficients_are_read(tmp_path):
    mc.write(flat_rig(), tmp_path / "dlt.csv", "dlt")
    table = np.loadtxt(tmp_path / "dlt.csv", delimiter=",")
    savemat(tmp_path / "easyWandData.mat", {"easyWandData": {"coefs": table}})
    found = mc.read_rig(tmp_path / "easyWandData.mat")
    np.testing.assert_allclose(found.rotation, flat_rig().rotation, atol=1e-9)


def test_vicon_s_correction_of_measured_points_becomes_a_distortion(tmp_path):
    """To 0.05 px: the inverse of a polynomial is none."""
    text = (CORPUS / "cameras/vicon/session.xcp").read_text("utf-8")
    first, second = 2e-8, -1e-15
    text = text.replace(' 0 0 0" WORLD', f' {first} {second} 0" WORLD')
    (tmp_path / "a.xcp").write_text(text)
    camera = mc.read_rig(tmp_path / "a.xcp").cameras[0]
    measured = np.array([[10.0, 10.0], [1270.0, 700.0], [300.0, 500.0]])
    offset = measured - camera.matrix[:2, 2]
    squared = (offset**2).sum(-1, keepdims=True)
    corrected = offset * (1 + first * squared + second * squared**2) / camera.matrix[0, 0]
    # one focal length: as far as the pixels are square
    points = np.column_stack([corrected, np.ones(3)])
    matrix = np.diag([camera.matrix[0, 0], camera.matrix[0, 0], 1.0])
    matrix[:2, 2] = camera.matrix[:2, 2]
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, camera.distortion)
    np.testing.assert_allclose(pixels[:, 0], measured, atol=0.05)


def test_opencap_s_pickle_is_read_and_calls_nothing(tmp_path):
    rig = mc.read_rig(CORPUS / "cameras" / "mocap-calib")
    found = mc.read_rig(CORPUS / "cameras" / "opencap" / "cam1")
    assert (found.names, found.unit, found.cameras[0].size) == (("cam1",), "mm", (1280, 720))
    np.testing.assert_allclose(found.translation[0], rig.translation[0] * 1000, atol=1e-9)

    class Call:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "made"),)

    content = {"intrinsicMat": Call(), "distortion": 0, "imageSize": 0}
    (tmp_path / "x.pickle").write_bytes(pickle.dumps(content))
    check(tmp_path / "x.pickle", "a pickle that calls")
    assert not (tmp_path / "made").exists()
