"""What is particular to one camera format: small files as other programs write them, and numbers.

A row of a table has the files, and what is read of them or a pattern of the refusal.
"""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
import yaml
from golden.command import call
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import mocap_calib as mc

TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
K = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
FLAT = [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]
REFUSED = "expected .+, found .+; .+"
Files = Mapping[str, object] | str


def write(folder: Path, files: Files) -> Path:
    """Write texts, JSON or bytes by their names, or one text; return what is read."""
    named = {"rig.x": files} if isinstance(files, str) else files
    for name, content in named.items():
        text = content if isinstance(content, str | bytes) else json.dumps(content)
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / next(iter(named)) if len(named) == 1 else folder


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


# --- TOML

SECTION = f"""
[{{section}}]
size = [640.0, 480.0]
matrix = {K}
distortions = [0.1, -0.2, 0.0, 0.0]
"""
POSED = SECTION + "rotation = [0.0, 0.0, {angle}]\ntranslation = [1.0, 2.0, 3.0]\n"
PLAIN = POSED.format(section="a", angle=0.5)
LENS = "[0.1, -0.2, 0.0, 0.0]"
VECTOR = "[0.0, 0.0, 0.5]"
FREEMOCAP = (
    PLAIN + "world_orientation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nworld_position = [0, 0, 0]\n"
)
OTHER = SECTION.format(section="b") + 'rotation = "null"\n'


def edited(old: str, new: object, more: str = "") -> str:
    assert old in PLAIN
    return PLAIN.replace(old, str(new)) + more


def lens(given: object, kept: object, fisheye: bool = False) -> tuple[str, dict[str, object]]:
    text = edited(LENS, json.dumps(given), f"fisheye = {json.dumps(fisheye)}\n")
    return text, {"distortion": kept, "fisheye": fisheye}


TOML = {
    "any name, and one below another": (
        POSED.format(section="left", angle=0.0)
        + POSED.format(section="cameras.7", angle=0.0)
        + "[board]\nkind = 'charuco'\n[metadata]\nunit = 'mm'\n",
        {"names": ["left", "7"], "unit": "mm", "size": (640, 480), "translation": [1, 2, 3]},
    ),
    "a rotation vector": (PLAIN, {"rotation": Rotation.from_rotvec([0, 0, 0.5]).as_matrix()}),
    "a rotation that is a matrix": (edited(VECTOR, TURN.tolist()), {"rotation": TURN}),
    "a rotation that is rounded": (
        edited(VECTOR, TURN.round(12).tolist()),
        {"rotation": TURN, "unit": "arbitrary"},
    ),
    "intrinsics alone": (PLAIN + OTHER, r"extrinsics .* none of b"),
    "intrinsics of both": (PLAIN + OTHER, {"names": ["a", "b"]}),
    "FreeMoCap's": (FREEMOCAP, {"unit": "mm"}),
    "not FreeMoCap's": (FREEMOCAP.replace("world_", "other_"), {"unit": "arbitrary"}),
    "no coefficient": lens([], [0] * 5),
    "1 coefficient": lens([0.1], [0.1, 0, 0, 0, 0]),
    "2 coefficients": lens([0.1, 0.2], [0.1, 0.2, 0, 0, 0]),
    "4 coefficients": lens([1, 2, 3, 4], [1, 2, 3, 4]),
    "a sixth of zero": lens([1, 2, 3, 4, 5, 0], [1, 2, 3, 4, 5]),
    "a row": lens([[1, 2, 3, 4, 5]], [1, 2, 3, 4, 5]),
    "12 coefficients": lens([*range(1, 9), 0, 0, 0, 0], range(1, 9)),
    "14 coefficients": lens([1, 2, 3, 4, 5] + [0] * 9, [1, 2, 3, 4, 5, 0, 0, 0]),
    "5 of a fisheye": lens([0.1, 0, 0, 0, 0], [0.1, 0, 0, 0], fisheye=True),
    "3 of a fisheye": lens([1, 2, 3], [1, 2, 3, 0], fisheye=True),
    # skew moves x by skew (y - cy) / fy, most at the farther edge: 240 px here
    "a skew of 0.0495 px": (
        edited("[[500.0, 0.0", f"[[500.0, {0.0495 * 501 / 240}"),
        {"matrix": K},
    ),
}

# --- YAML of OpenCV, ROS, Kalibr and our own


def opencv(name="K", header="%YAML:1.0\n---\n", extra="", cells=FLAT) -> str:
    def matrix(key: str, rows: int, columns: int, values: object) -> str:
        shape = f"rows: {rows}\n   cols: {columns}\n   dt: d"
        return f"{key}: !!opencv-matrix\n   {shape}\n   data: {values}\n"

    size = "image_width: 640\nimage_height: 480\n"
    distortion = matrix("D", 1, 5, "[ 0.1, -0.2, 0., 1e-3, 0. ]")
    return header + size + matrix(name, 3, 3, cells) + distortion + extra


def vector(key: str, value: float) -> str:
    return (
        f"{key}: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 0., {value}, 0. ]\n"
    )


def ros(k="K", d="D", model="plumb_bob") -> str:
    head = f"header:\n  seq: 1\nheight: 480\nwidth: 640\ndistortion_model: {model}\n"
    return head + f"{d}: [0.1, -0.2, 0.0, 0.001, 0.0]\n{k}: {FLAT}\nR: {[1, 0, 0] * 3}\n---\n"


def kalibr(**changes: object) -> dict[str, object]:
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [500, 501, 320, 240],
        "resolution": [640, 480],
    }
    lens = {"distortion_model": "radtan", "distortion_coeffs": [0.1, 0, 0.01, 0]}
    return camera | lens | {"rostopic": "/a", "cam_overlaps": []} | changes


STEP = np.eye(4)
STEP[:3, :3], STEP[:3, 3] = TURN, [1, 2, 3]
CHAIN = {"cam0": kalibr(), **{f"cam{k}": kalibr(T_cn_cnm1=STEP.tolist()) for k in range(1, 11)}}
SEEN = {"size": (640, 480), "fisheye": False, "matrix": K, "distortion": [0.1, -0.2, 0, 1e-3, 0]}
OURS = f"""format: mocap-calib cameras
version: 1
cameras:
- {{name: a, size: [64, 48], model: opencv, K: {K}, distortion: [0, 0, 0, 0, 0],
   R: {np.eye(3).tolist()}, t: [0.0, 0.0, 1.0]}}
"""
ROS_INFO = (
    "image_width: 640\nimage_height: 480\ncamera_name: rgb\n"
    f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {FLAT}\ndistortion_model: equidistant\n"
    "distortion_coefficients:\n  rows: 1\n  cols: 4\n  data: [0.1, 0, 0, 0]\n"
)
YAML = {
    **{
        f"{name} after {header!r}": ({"left.yml": opencv(name, header)}, SEEN | {"names": ["left"]})
        for header in ("%YAML:1.0\n---\n", "%YAML 1.2\n---\n", "%YAML:1.0\r\n---\r\n", "")
        for name in ("camera_matrix", "K", "M1")
    },
    "no size and no distortion": (
        {"x.yml": f"%YAML:1.0\n---\nK: {K}\n"},
        {"size": (0, 0), "distortion": [0] * 5},
    ),
    "a folder of cameras": (
        {
            **{
                f"{name}.yaml": opencv(extra=vector("rvec", angle) + vector("tvec", 2.0))
                for name, angle in (("b", 0.5), ("a", -0.5))
            },
            "notes.txt": "no camera",
        },
        {
            "names": ["a", "b"],
            "rotation": Rotation.from_rotvec([0, 0.5, 0]).as_matrix(),
            "translation": [0, 2, 0],
        },
    ),
    "rostopic echo": ({"left.yaml": ros()}, SEEN | {"names": ["left"]}),
    "ros2 topic echo": ({"left.yaml": ros("k", "d")}, SEEN | {"names": ["left"]}),
    "camera_info": (
        {"x.yaml": ROS_INFO},
        {"names": ["rgb"], "size": (640, 480), "fisheye": True},
    ),
    "a chain of Kalibr": (
        {"x.yaml": yaml.safe_dump(CHAIN)},  # cam10 comes after cam9, not after cam1
        {
            "names": [f"cam{k}" for k in range(11)],
            "unit": "m",
            "rotation": np.linalg.matrix_power(STEP, 10)[:3, :3],
            "translation": np.linalg.matrix_power(STEP, 10)[:3, 3],
        },
    ),
    "a chain with a gap": (
        {"x.yaml": yaml.safe_dump({"cam0": kalibr(), "cam1": kalibr(), "cam2": CHAIN["cam1"]})},
        r"extrinsics .* none of cam1, cam2",
    ),
    "ours": (OURS, {"names": ["a"], "unit": "arbitrary", "translation": [0, 0, 1]}),
    "too large": ({"x.yaml": "K: " + "[1]," * 1_100_000}, "below 2 MB"),
    "a crowd of values": ({"x.yaml": "camera_matrix: [" + "1," * 60_000 + "1]\n"}, "50000 values"),
    **{
        name: (text, REFUSED)
        for name, text in {
            "long nothing": " \n" * 100_000,
            "deep nothing": "[" * 200_000,
            "one word": "a" * 1_000_000,
        }.items()
    },
}

# --- JSON, MATLAB and COLMAP's text


def intrinsic(key: int, named: bool, terms: list[float]) -> dict[str, Any]:
    word = {"polymorphic_id": 2147483649, "polymorphic_name": "pinhole_radial_k3"}
    lens = {"focal_length": 500.0, "principal_point": [320.0, 240.0], "disto_k3": terms}
    value = (word if named else {"polymorphic_id": 1}) | {
        "ptr_wrapper": {"id": 2147483660 + key, "data": {"width": 640, "height": 480} | lens}
    }
    return {"key": key, "value": value}


def view(key: int, of: int) -> dict[str, Any]:
    data = {"filename": f"{key}.jpg", "id_view": key, "id_intrinsic": of, "id_pose": key}
    size = {"local_path": "/", "width": 640, "height": 480}
    wrapped = {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 1, "data": data | size}}
    return {"key": key, "value": wrapped}


WORLD = np.eye(4)
WORLD[:3, :3], WORLD[:3, 3] = TURN.T * [1, -1, -1], -TURN.T @ [1.0, 2, 3]
NERF = {
    **{"fl_x": 500.0, "fl_y": 501.0, "cx": 320.5, "cy": 240.5, "w": 640, "h": 480, "k1": 0.1},
    "frames": [{"file_path": "./images/frame_1.jpg", "transform_matrix": WORLD.tolist()}],
}
VOXEL = {
    **{"R": TURN.tolist(), "T": [[1], [2], [3]], "fx": 500, "fy": 501, "cx": 320, "cy": 240},
    **{"k": [[0.1], [0], [0.2]], "p": [[0.01], [0]]},
}
MVG = {
    **{"sfm_data_version": "0.3", "root_path": "/", "structure": []},
    "views": [view(0, 0), view(1, 1)],
    "intrinsics": [intrinsic(0, True, [0.1, 0.2, 0.3]), intrinsic(1, False, [0, 0, 0])],
    "extrinsics": [
        {"key": k, "value": {"rotation": TURN.tolist(), "center": [1.0, 2, 3]}} for k in range(2)
    ],
}
PANOPTIC = {"name": "00_00", "resolution": [1920, 1080], "K": K, "distCoef": [0.1, 0, 0, 0, 0]}
PANOPTIC |= {"type": "hd", "panel": 0, "node": 0, "R": TURN.tolist(), "t": [[1], [2], [3]]}
TERMS = [0.1, 0.2, 0.0, 0.0, 0.01, 0.3, 0.02, 0.04] + [0.0] * 6
POSED_6 = {"K": K, "dist": TERMS, "R": np.eye(3).tolist(), "t": [0, 0, 1]}
REFINED = [[490.0, 0, 320], [0, 491.0, 240], [0, 0, 1]]
LISTED = (
    "# Camera list\n1 SIMPLE_RADIAL 640 480 500 320.5 240.5 0.1\n"
    "2 OPENCV_FISHEYE 640 480 500 501 320.5 240.5 0.1 0 0 0\n"
)
IMAGES = (
    "# Image list\n1 1 0 0 0 1 2 3 1 a/left.JPG\n12.5 13 -1 14 15 7\n\n"
    "2 0.5 0.5 0.5 0.5 0 0 0 1 a/right.JPG\n\n3 -1 0 0 0 0 0 1 2 fish.png"
)


def colmap(cameras: str, images: str = IMAGES) -> dict[str, object]:
    return {"cameras.txt": cameras + "\n", "images.txt": images}


ONE = "1 PINHOLE 6 4 1 1 1 1"
JSON = {
    "nerfstudio": (
        {"x.json": NERF | {"camera_model": "OPENCV"}},
        {
            **{"names": ["frame_1"], "matrix": K, "distortion": [0.1, 0, 0, 0, 0]},
            **{"rotation": TURN, "translation": [1, 2, 3]},
        },
    ),
    "nerfstudio's k4 of a fisheye": (
        {"x.json": NERF | {"camera_model": "OPENCV_FISHEYE", "k4": 0.3}},
        {"distortion": [0.1, 0, 0, 0.3], "fisheye": True},
    ),
    "nerfstudio's k4 of zero": ({"x.json": NERF | {"k4": 0.0}}, {"distortion": [0.1, 0, 0, 0, 0]}),
    "openMVG": (
        {"x.json": MVG},
        {
            **{"names": ["0", "1"], "distortion": [0.1, 0.2, 0, 0, 0.3]},
            **{"rotation": TURN, "translation": -TURN @ [1, 2, 3]},
        },
    ),
    "openMVG without a pose": (
        {"x.json": MVG | {"extrinsics": MVG["extrinsics"][:1]}},
        "none of 1",
    ),
    "CMU Panoptic": (
        {"x.json": {"calibDataSource": "160906_calib_norm", "cameras": [PANOPTIC]}},
        {"names": ["00_00"], "unit": "cm", "size": (1920, 1080), "translation": [1, 2, 3]},
    ),
    "VoxelPose": (
        {"x.json": {"seq": [VOXEL | {"T": [0, 0, 1]}, VOXEL]}},
        {
            **{"names": ["0", "1"], "distortion": [0.1, 0, 0.01, 0, 0.2]},
            **{"translation": -TURN @ [1, 2, 3], "unit": "mm"},
        },
    ),
    "multiview_calib": (
        {
            "intrinsics.json": {"6-0": {"K": K, "dist": TERMS, "image_shape": [480, 640]}},
            "ba_poses.json": {"6-0": POSED_6},
            "global_poses.json": {
                "6-0": {"K": REFINED, "dist": TERMS, "R": TURN.tolist(), "t": [1, 2, 3]}
            },
        },
        {
            **{"names": ["6-0"], "size": (640, 480), "matrix": REFINED, "distortion": TERMS[:8]},
            **{"rotation": TURN, "translation": [1, 2, 3]},
        },
    ),
    "COLMAP": (
        colmap(LISTED),
        {
            **{
                "names": ["a/left", "a/right", "fish"],
                "matrix": [[500, 0, 320], [0, 500, 240], [0, 0, 1]],
            },
            **{"distortion": [0.1, 0, 0, 0, 0], "rotation": np.eye(3), "translation": [0, 0, 1]},
        },
    ),
}


@pytest.mark.parametrize(
    ("files", "expected"),
    [pytest.param(*case, id=name) for kind in (TOML, YAML, JSON) for name, case in kind.items()],
)
def test_a_detail_is_read_or_refused(files, expected, tmp_path):
    check(write(tmp_path, files), expected)


SAME = {name: PANOPTIC | {"name": name} for name in ("a", "b")}
TURNED_SAME = SAME["b"] | {"R": np.eye(3).tolist()}
MOVED_SAME = SAME["b"] | {"t": [[1], [2], [4]]}
UNKNOWN = view(3, 4294967295)
NOTES = {
    "cameras in one place": (
        {"x.json": {"cameras": list(SAME.values())}},
        r"cameras a and b stand in the same place",
    ),
    "that look another way": ({"x.json": {"cameras": [SAME["a"], TURNED_SAME]}}, ""),
    "that stand elsewhere": ({"x.json": {"cameras": [SAME["a"], MOVED_SAME]}}, ""),
    "a view without intrinsics": (
        {"x.json": MVG | {"views": [*MVG["views"], UNKNOWN]}},
        "3 has no intrinsics",
    ),
    "intrinsics alone": (PLAIN + OTHER, "stand: b"),
}


@pytest.mark.parametrize(("files", "note"), NOTES.values(), ids=NOTES)
def test_what_is_odd_is_noted(files, note, tmp_path):
    path = write(tmp_path, files)
    done = call("convert", path.name, "out.yaml", folder=tmp_path)
    assert done.status == 0
    assert note in "\n".join(done.stderr)
    assert note or len(done.stderr) == 1


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
