"""Camera files in the words of the programs that write them, made here after their writers' code or
documentation.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest
from test_formats_cameras import studio

from mocap_calib.errors import FormatError
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras.intrinsics import make_camera
from mocap_calib.io.cameras.read import _note_same_places, load_cameras, make_rig, parse_content
from mocap_calib.io.cameras.write import write_cameras

K = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
TURN = matrix_from_vector(np.array([0.3, -0.2, 0.5]))


def only(text, path="x.yaml", name=None):
    found = parse_content(text.encode(), path, name)
    (camera,) = found.cameras
    return camera, found


def test_rostopic_echo_of_camera_info():
    """Lower case in ROS 2, flat K, a line that begins another document; R and P are no place of the
    camera.
    """
    for k, d, r in (("K", "D", "R"), ("k", "d", "r")):
        text = (
            f"header:\n  seq: 1\nheight: 480\nwidth: 640\n"
            f"distortion_model: plumb_bob\n{d}: [0.1, -0.2, 0.0, 0.001, 0.0]\n"
        )
        text += (
            f"{k}: [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]\n"
            f"{r}: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\n---\n"
        )
        camera, found = only(text, "left.yaml")
        assert (camera.name, camera.size, camera.fisheye, found.extrinsics) == (
            "left",
            (640, 480),
            False,
            {},
        )
        np.testing.assert_array_equal(camera.matrix, K)
        np.testing.assert_array_equal(camera.distortion, [0.1, -0.2, 0, 0.001, 0])


def test_a_distortion_model_that_nobody_has_is_refused():
    with pytest.raises(FormatError, match="distortion model"):
        only(
            "distortion_model: fov\n"
            "camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 501, 240, 0, 0, 1]}\n"
        )


def kalibr(**changes):
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [500, 501, 320, 240],
        "distortion_model": "radtan",
        "distortion_coeffs": [0.1, 0, 0.01, 0],
    }
    return camera | {"resolution": [640, 480], "rostopic": "/a", "cam_overlaps": []} | changes


def test_kalibr_chains_its_cameras():
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = TURN, [1, 2, 3]
    chain = {
        f"cam{k}": kalibr(T_cn_cnm1=step.tolist()) for k in range(11)
    }  # cam10 comes after cam9
    del chain["cam0"]["T_cn_cnm1"]
    rig = make_rig(
        parse_content(
            json.dumps(dict(sorted(chain.items()))).replace("{", "{\n").encode(), "x", "kalibr"
        ),
        "x",
    )
    assert rig.names == tuple(f"cam{k}" for k in range(11))
    np.testing.assert_allclose(
        rig.rotation[10], np.linalg.matrix_power(step, 10)[:3, :3], atol=1e-12
    )
    np.testing.assert_allclose(
        rig.translation[10], np.linalg.matrix_power(step, 10)[:3, 3], atol=1e-12
    )
    assert rig.unit == "m"


def test_kalibr_after_a_gap_knows_no_place():
    chain = {"cam0": kalibr(), "cam1": kalibr(), "cam2": kalibr(T_cn_cnm1=np.eye(4).tolist())}
    assert list(parse_content(json.dumps(chain).encode(), "x", "kalibr").extrinsics) == ["cam0"]
    for change in ({"camera_model": "omni"}, {"distortion_model": "fov"}, {"intrinsics": [1, 2]}):
        with pytest.raises(FormatError):
            parse_content(json.dumps({"cam0": kalibr(**change)}).encode(), "x", "kalibr")


def test_multiview_calib_keeps_sizes_beside_refined_poses(tmp_path):
    lens = [0.1, 0.2, 0.0, 0.0, 0.01, 0.3, 0.02, 0.04] + [0.0] * 6
    intrinsics = {"6-0": {"K": K, "dist": lens, "K_new": K, "image_shape": [480, 640]}}
    (tmp_path / "intrinsics.json").write_text(json.dumps(intrinsics))
    refined = [[490.0, 0, 320], [0, 491.0, 240], [0, 0, 1]]
    (tmp_path / "ba_poses.json").write_text(
        json.dumps({"6-0": {"K": K, "dist": lens, "R": np.eye(3).tolist(), "t": [0, 0, 1]}})
    )
    (tmp_path / "global_poses.json").write_text(
        json.dumps({"6-0": {"K": refined, "dist": lens, "R": TURN.tolist(), "t": [1, 2, 3]}})
    )
    rig = make_rig(load_cameras(tmp_path), "x")
    assert (rig.names, rig.cameras[0].size) == (("6-0",), (640, 480))
    np.testing.assert_array_equal(rig.cameras[0].matrix, refined)
    np.testing.assert_array_equal(rig.cameras[0].distortion, lens[:8])
    np.testing.assert_array_equal(rig.translation, [[1, 2, 3]])


def test_nerfstudio_shares_what_stands_at_the_top():
    """Images are numbered, a world turned by applied_transform is a world as good."""
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = TURN.T * [1, -1, -1], -TURN.T @ [1.0, 2, 3]
    tree = {
        "camera_model": "OPENCV",
        "fl_x": 500.0,
        "fl_y": 501.0,
        "cx": 320.5,
        "cy": 240.5,
        "w": 640,
        "h": 480,
        "k1": 0.1,
        "applied_transform": [[1, 0, 0, 0]],
    }
    rig = make_rig(
        only(
            json.dumps(
                tree
                | {
                    "frames": [
                        {"file_path": "./images/frame_1.jpg", "transform_matrix": world.tolist()}
                    ]
                }
            )
        )[1],
        "x",
    )
    assert rig.names == ("frame_1",)
    np.testing.assert_array_equal(rig.cameras[0].matrix, K)
    np.testing.assert_allclose(rig.rotation[0], TURN, atol=1e-15)
    np.testing.assert_allclose(rig.translation[0], [1, 2, 3], atol=1e-15)


def test_openmvg_names_a_model_once_and_shares_intrinsics():
    def intrinsic(key, named, lens):
        word = (
            {"polymorphic_id": 2147483649, "polymorphic_name": "pinhole_radial_k3"}
            if named
            else {"polymorphic_id": 1}
        )
        data = {
            "width": 640,
            "height": 480,
            "focal_length": 500.0,
            "principal_point": [320.0, 240.0],
            "disto_k3": lens,
        }
        return {"key": key, "value": word | {"ptr_wrapper": {"id": 2147483660 + key, "data": data}}}

    def view(key, of):
        data = {
            "local_path": "/",
            "filename": f"{key}.jpg",
            "width": 640,
            "height": 480,
            "id_view": key,
            "id_intrinsic": of,
            "id_pose": key,
        }
        return {
            "key": key,
            "value": {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 1, "data": data}},
        }

    tree = {
        "sfm_data_version": "0.3",
        "root_path": "/",
        "views": [view(0, 0), view(1, 1), view(2, 1), view(3, 4294967295)],
    }
    tree |= {
        "intrinsics": [intrinsic(0, True, [0.1, 0.2, 0.3]), intrinsic(1, False, [0, 0, 0])],
        "structure": [],
    }
    tree["extrinsics"] = [
        {"key": k, "value": {"rotation": TURN.tolist(), "center": [1.0, 2, 3]}} for k in range(2)
    ]
    found = only_many(json.dumps(tree))
    assert [camera.name for camera in found.cameras] == ["0", "1", "2"]
    np.testing.assert_array_equal(found.cameras[0].distortion, [0.1, 0.2, 0, 0, 0.3])
    np.testing.assert_allclose(found.extrinsics["0"][1], -TURN @ [1, 2, 3])
    assert "2" not in found.extrinsics
    assert any("3 has no intrinsics" in note for note in found.notes)


def only_many(text):
    return parse_content(text.encode(), "x.json")


def test_panoptic_takes_what_the_data_set_has():
    cameras = [
        {
            "name": f"00_0{k}",
            "type": "hd",
            "resolution": [1920, 1080],
            "panel": 0,
            "node": k,
            "K": K,
            "distCoef": [0.1, 0, 0, 0, 0],
            "R": TURN.tolist(),
            "t": [[1], [2], [3]],
        }
        for k in range(2)
    ]
    found = only_many(json.dumps({"calibDataSource": "160906_calib_norm", "cameras": cameras}))
    assert ([c.name for c in found.cameras], found.unit, found.cameras[0].size) == (
        ["00_00", "00_01"],
        "cm",
        (1920, 1080),
    )
    assert any("same place" in note for note in found.notes)


def test_cameras_that_only_look_one_way_are_in_no_doubt():
    """Nor are those that only stand in one place."""
    turn, other = np.eye(3), matrix_from_vector(np.array([0.0, 0.3, 0.0]))
    here, there = np.array([0.0, 0, 1]), np.array([1.0, 0, 1])
    placed = {"a": (turn, here), "b": (turn, there), "c": (other, here)}
    assert _note_same_places(SimpleNamespace(extrinsics=placed)) == []
    (note,) = _note_same_places(SimpleNamespace(extrinsics=placed | {"d": (turn, there)}))
    assert "cameras b and d" in note


def test_freemocap_is_told_from_anipose_by_what_it_adds():
    text = (
        f'[cam_0]\nid = "0"\nname = "cam_0"\nsize = [640, 480]\nmatrix = {K}\n'
        f"distortions = [0.1, 0.0, 0.0, 0.0, 0.0]\nrotation = [0.0, 0.0, 0.0]\n"
    )
    text += (
        "translation = [0.0, 0.0, 900.0]\nworld_orientation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n"
        "world_position = [0, 0, -900]\n[metadata]\nerror = 0.1\n"
    )
    assert only(text)[1].unit == "mm"
    assert only(text.replace("world_", "other_"))[1].unit == "arbitrary"


def test_colmap_models_and_comments(tmp_path):
    """Shared cameras, models of few parameters, points on the second lines, a last image without
    its second line.
    """
    (tmp_path / "cameras.txt").write_text(
        "# Camera list\n1 SIMPLE_RADIAL 640 480 500 320.5 240.5 0.1\n"
        "2 OPENCV_FISHEYE 640 480 500 501 320.5 240.5 0.1 0 0 0\n"
    )
    images = (
        "# Image list\n1 1 0 0 0 1 2 3 1 a/left.JPG\n12.5 13 -1 14 15 7\n\n"
        "2 0.5 0.5 0.5 0.5 0 0 0 1 a/right.JPG\n\n3 -1 0 0 0 0 0 1 2 fish.png"
    )
    (tmp_path / "images.txt").write_text(images)
    rig = make_rig(load_cameras(tmp_path), "x")
    assert rig.names == ("a/left", "a/right", "fish")
    np.testing.assert_array_equal(rig.cameras[0].matrix, [[500, 0, 320], [0, 500, 240], [0, 0, 1]])
    np.testing.assert_array_equal(rig.cameras[0].distortion, [0.1, 0, 0, 0, 0])
    assert rig.cameras[2].fisheye
    np.testing.assert_allclose(rig.rotation[1] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(rig.rotation[2], np.eye(3))
    for broken, reason in (
        ("1 OPENCV 640 480 500", "without the parameters of its model"),
        (
            "1 PINHOLE 6 4 1 1 1 1\n2 THIN_PRISM_FISHEYE 6 4" + " 1" * 12,
            "camera 2: expected one of the camera models .* found THIN_PRISM_FISHEYE",
        ),
        ("1 PINHOLE 640", "a line of cameras.txt that is not CAMERA_ID MODEL"),
        ("1 PINHOLE 6 4 1 1 1 1\n1 PINHOLE 6 4 1 1 1 1", "two cameras with one CAMERA_ID"),
        ("1 PINHOLE 6 4 1 1 1 1", "an image whose CAMERA_ID is of no camera"),
    ):
        (tmp_path / "cameras.txt").write_text(broken + "\n")
        with pytest.raises(FormatError, match=f"^{tmp_path}:.*{reason}"):
            load_cameras(tmp_path)
    (tmp_path / "images.txt").write_text("1 0 0 0 0 1 2 3 1 a.png\n\n")
    with pytest.raises(FormatError, match=r"image a.png: expected a unit quaternion"):
        load_cameras(tmp_path)


def test_voxelpose_of_a_sequence_and_of_two():
    fields = {
        "R": TURN.tolist(),
        "T": [[1], [2], [3]],
        "fx": 500,
        "fy": 501,
        "cx": 320,
        "cy": 240,
        "k": [[0.1], [0], [0.2]],
        "p": [[0.01], [0]],
    }
    found = only_many(json.dumps({"seq": [fields, fields | {"T": [0, 0, 1]}]}))
    assert [camera.name for camera in found.cameras] == ["0", "1"]
    np.testing.assert_array_equal(found.cameras[0].distortion, [0.1, 0, 0.01, 0, 0.2])
    np.testing.assert_allclose(found.extrinsics["0"][1], -TURN @ [1, 2, 3])
    with pytest.raises(FormatError, match="2 sequences"):
        only_many(json.dumps({"a": [fields], "b": [fields]}))


@pytest.mark.parametrize("fisheye", [False, True])
def test_pycolmap_and_opencv_project_our_files_alike(fisheye, tmp_path):
    """1e-6 px at f = 1000 px (measured 3e-13); COLMAP's pixels are half a pixel more."""
    rig = studio("colmap")
    if fisheye:
        rig = replace(
            rig,
            cameras=tuple(
                replace(camera, distortion=np.array([0.02, -0.01, 2e-3, 1e-3]), fisheye=True)
                for camera in rig.cameras
            ),
        )
    points = np.random.default_rng(0).uniform(-0.5, 0.5, size=(20, 3))
    ours = [
        pixels_from_points(camera, points @ rig.rotation[v].T + rig.translation[v])
        for v, camera in enumerate(rig.cameras)
    ]

    write_cameras(tmp_path / "model", rig, "colmap")
    model = pycolmap.Reconstruction(str(tmp_path / "model"))
    for image in model.images.values():
        moved, camera = image.cam_from_world(), model.cameras[image.camera_id]
        theirs = [
            np.ravel(camera.img_from_cam(ray))
            for ray in points @ moved.rotation.matrix().T + moved.translation
        ]
        np.testing.assert_allclose(
            np.array(theirs) - 0.5,
            ours[rig.names.index(image.name.removesuffix(".png"))],
            rtol=0,
            atol=1e-6,
        )

    write_cameras(tmp_path / "yaml", rig, "opencv")
    for v, name in enumerate(rig.names):
        file = cv2.FileStorage(str(tmp_path / "yaml" / f"{name}.yml"), cv2.FILE_STORAGE_READ)
        K, D, R, T = (
            file.getNode(key).mat()
            for key in ("camera_matrix", "distortion_coefficients", "R", "T")
        )
        project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
        found, _ = project(points[:, None], cv2.Rodrigues(R)[0], T, K, D)
        np.testing.assert_allclose(found[:, 0], ours[v], rtol=0, atol=1e-6)


@pytest.mark.parametrize("skew", [1e308, -1e308, 0.5])
def test_a_skew_of_any_size_is_refused_in_a_line(skew):
    """Found by fuzzing: what it moves overflows."""
    cell = [[500.0, skew, 320.0], [0.0, 501.0, 1e300], [0.0, 0.0, 1.0]]
    with pytest.raises(FormatError, match="without skew"):
        make_camera(
            name="a", size=(640, 480), matrix=cell, distortion=None, fisheye=False, source="x"
        )
