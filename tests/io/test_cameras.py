"""The laws of camera formats, over the table of formats in `conformance.CAMERAS`.

What is written comes back, or is refused in a line without a file; other programs project our
files as we do.
"""

import re
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import yaml
from conformance import CAMERAS, CORPUS, READ_ONLY, Cameras
from golden.command import call
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs import assert_same, padded, rigs

import mocap_calib as mc
from mocap_calib.types import EstimatedCamera

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def studio(name: str = "anipose", count: int = 3) -> mc.CameraRig:
    """Return three cameras around a room, which the format carries."""
    lens = (
        np.zeros(5) if CAMERAS[name].lengths == (0,) else np.array([-0.1, 0.02, 1e-3, -2e-3, 1e-3])
    )
    matrix = np.array([[1000.0, 0, 640], [0, 1000, 360], [0, 0, 1]])
    cameras = tuple(mc.Camera(f"cam{k}", (1280, 720), matrix, lens) for k in range(count))
    turns = [cv2.Rodrigues(np.array([0.1, angle, 0.05]))[0] for angle in (0.0, 1.5, 3.0)[:count]]
    return mc.CameraRig(cameras, np.stack(turns), np.tile([0.1, -0.2, 4.0], (count, 1)), "m")


def contents(path: Path) -> dict[str, bytes]:
    files = [path] if path.is_file() else sorted(path.iterdir())
    return {file.name if path.is_dir() else "": file.read_bytes() for file in files}


def carries(form: Cameras, camera: mc.Camera) -> bool:
    square = abs(camera.matrix[0, 0] / camera.matrix[1, 1] - 1) < 1e-4
    fits = form.fisheye if camera.fisheye else not padded(camera)[max(form.lengths) :].any()
    return fits and (square or not form.square)


@pytest.mark.parametrize("name", CAMERAS)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_what_is_written_comes_back_or_is_refused_in_a_line(name, data, tmp_path_factory):
    form, path = CAMERAS[name], tmp_path_factory.mktemp("rig") / "rig"
    fitting = rigs(form.lengths, form.fisheye, square=form.square, units=(*METRES, "arbitrary"))
    rig = data.draw(st.one_of(fitting, fitting, rigs(units=("m",))))
    kept = all(carries(form, camera) for camera in rig.cameras)
    if kept and not (form.unit and rig.unit == "arbitrary"):
        lost = mc.write(rig, path, name)
        found = mc.read_rig(path)
        gone = not form.stated and rig.unit != "arbitrary"
        assert any("unit of length" in what for what in lost) == gone
        if name in ("opencv", "jarvis"):  # a file a camera
            rig = rig.select(np.argsort([f"{each}.y" for each in rig.names]))
        scale = METRES[rig.unit] / METRES[form.unit] if form.unit else 1.0
        assert found.unit == ((form.unit or rig.unit) if form.stated else "arbitrary")
        assert_same(rig, found, sizes=form.sizes, names=form.names, scale=scale)
        return
    with pytest.raises(mc.MismatchError, match=r"expected .*found") as refused:
        mc.write(rig, path, name)
    assert "\n" not in str(refused.value)
    assert not kept or "mocap-calib scale" in str(refused.value)
    assert kept or any(f"camera {each}" in str(refused.value) for each in rig.names)
    assert not path.exists()


@pytest.mark.parametrize("name", READ_ONLY)
def test_one_rig_is_equal_in_the_formats_that_are_only_read(name):
    rig, unit = mc.read_rig(CORPUS / "cameras" / "mocap-calib"), READ_ONLY[name]
    (path,) = (CORPUS / "cameras" / name).iterdir()
    found = mc.read_rig(path)
    assert found.unit == (unit or "arbitrary")
    scale = 1000.0 if unit == "mm" else 1.0
    np.testing.assert_allclose(found.rotation, rig.rotation, atol=1e-9)
    np.testing.assert_allclose(found.translation, rig.translation * scale, atol=1e-6 * scale)
    for camera, wanted in zip(found.cameras, rig.cameras, strict=True):
        np.testing.assert_allclose(camera.matrix, wanted.matrix, atol=1e-6)
        lens = np.zeros(5) if name in ("dlt", "vicon") else wanted.distortion
        np.testing.assert_allclose(camera.distortion, lens, atol=1e-12)
        assert camera.size == ((0, 0) if name == "dlt" else wanted.size)


# --- other programs: camera matrix, distortion, rotation, translation of each camera

Placed = Iterator[tuple[object, object, object, object]]


def _by_storage(path: Path, *keys: str) -> list[np.ndarray]:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    return [storage.getNode(key).mat() for key in keys]


def _by_opencv(path: Path) -> Placed:
    for file in sorted(path.iterdir()):
        yield _by_storage(file, "camera_matrix", "distortion_coefficients", "R", "T")


def _by_jarvis(path: Path) -> Placed:
    for file in sorted(path.iterdir()):
        k, d, r, t = _by_storage(file, "intrinsicMatrix", "distortionCoefficients", "R", "T")
        yield k.T, d, r.T, t


def _by_easymocap(path: Path) -> Placed:
    for name in ("cam0", "cam1", "cam2"):
        k, d = _by_storage(path / "intri.yml", f"K_{name}", f"dist_{name}")
        yield k, d, *_by_storage(path / "extri.yml", f"Rot_{name}", f"T_{name}")


def _by_colmap(path: Path) -> Placed:
    model = pycolmap.Reconstruction(path)
    for image in sorted(model.images.values(), key=lambda each: each.name):
        placed, camera = image.cam_from_world(), model.cameras[image.camera_id]
        k = camera.calibration_matrix() - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
        d = camera.params[4:]
        yield k, d, placed.rotation.matrix(), placed.translation


OTHERS = {
    "colmap": _by_colmap,
    "opencv": _by_opencv,
    "jarvis": _by_jarvis,
    "easymocap": _by_easymocap,
}
FISHEYE = np.array([0.02, -0.01, 2e-3, 1e-3])


@pytest.mark.parametrize(
    ("name", "fisheye"),
    [*((name, False) for name in OTHERS), ("opencv", True), ("colmap", True)],
)
def test_another_program_projects_our_files_as_we_do(name, fisheye, tmp_path):
    """1e-6 px at f = 1000 px (measured 3e-13); pixels of COLMAP are half more."""
    rig, project = studio(name), cv2.projectPoints
    if fisheye:
        cameras = [replace(each, distortion=FISHEYE, fisheye=True) for each in rig.cameras]
        rig, project = replace(rig, cameras=tuple(cameras)), cv2.fisheye.projectPoints
    mc.write(rig, tmp_path / "out", name)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, size=(20, 1, 3))
    scale = 1 / METRES[CAMERAS[name].unit or "m"]
    placed = list(OTHERS[name](tmp_path / "out"))
    assert len(placed) == 3
    for (k, d, r, t), expected in zip(placed, rig.project(points), strict=True):
        vector = cv2.Rodrigues(r)[0]
        found, _ = project(points * scale, vector, np.ravel(t), k, np.ravel(d))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


# --- verdicts, estimates, zeros and units

SIGMA = 12.34
ADVICE = "# mocap-calib: this rig is not determined: do not measure with it"
JUDGED = {
    "adjusted": True,
    "verdict": "not determined",
    "remarks": ["inconsistent: zo\u00eb's: 'left'"],
    "reprojection_error_px": 3.25,
    "centre_sigma_percent": {"zo\u00eb's": 1.5, "1": 0.25},
    "rotation_sigma_deg": {"zo\u00eb's": 0.5},
}


def judged(folder: Path, provenance: dict, name: str = "anipose") -> Path:
    """Write the studio as our own file with this provenance."""
    mc.write(studio(name), folder / "judged.yaml")
    tree = yaml.safe_load((folder / "judged.yaml").read_text("utf-8"))
    (folder / "judged.yaml").write_text(yaml.safe_dump(tree | {"provenance": provenance}), "utf-8")
    return folder / "judged.yaml"


@pytest.mark.parametrize("name", CAMERAS)
def test_the_verdict_goes_with_the_rig_wherever_there_is_room(name, tmp_path):
    """A conversion hands it on; where there is no room, it reports the loss."""
    judged(tmp_path, JUDGED, name)
    done = call("convert", "judged.yaml", "out", "--to", name, folder=tmp_path)
    assert done.status == 0
    room = CAMERAS[name].verdict
    assert any("the verdict on the rig" in line for line in done.stderr) == (not room)
    for content in contents(tmp_path / "out").values():
        assert (ADVICE.encode() in content) == (room == "comment")
    unit = () if CAMERAS[name].stated else ("--input-unit", "m")
    done = call("convert", "out", "again.yaml", *unit, folder=tmp_path)
    assert done.status == 0
    said = yaml.safe_load((tmp_path / "again.yaml").read_text("utf-8"))["provenance"]
    kept = {key: said[key] for key in JUDGED if key in said}
    short = {key: JUDGED[key] for key in ("adjusted", "verdict", "remarks")}
    assert kept in ((JUDGED, short) if room else ({},))


@pytest.mark.parametrize(
    ("edited", "kept"),
    [
        ("nothing of the kind", {}),
        ({"verdict": "excellent", "adjusted": "yes"}, {}),
        ({"remarks": ["a\nb: 1", "fine"]}, {}),
        ({"remarks": [3, "fine"]}, {}),
        ({"reprojection_error_px": float("nan")}, {}),
        ({"centre_sigma_percent": {"cam0": 1.0}}, {"centre_sigma_percent": {"cam0": 1.0}}),
        ({"centre_sigma_percent": {"cam0": -1.0}}, {}),
        ({"rotation_sigma_deg": {"cam0": 1.0, "cam1": "small"}}, {}),
        ({"frames": [9]}, {}),
    ],
)
def test_an_edited_verdict_is_not_handed_on(edited, kept, tmp_path):
    judged(tmp_path, edited)
    assert call("convert", "judged.yaml", "out.toml", folder=tmp_path).status == 0
    text = (tmp_path / "out.toml").read_text("utf-8")
    said = tomllib.loads(text)["metadata"]["provenance"]
    assert {key: said[key] for key in JUDGED | {"frames": 0} if key in said} == kept
    assert "this rig is" not in text


def test_a_comment_of_another_word_is_no_verdict(tmp_path):
    mc.write(studio(), tmp_path / "a.toml")
    content = (tmp_path / "a.toml").read_text()
    (tmp_path / "a.toml").write_text("# mocap-calib: this rig is splendid\n#   remark\n" + content)
    assert call("convert", "a.toml", "b.yaml", folder=tmp_path).status == 0
    assert "splendid" not in (tmp_path / "b.yaml").read_text()


@pytest.mark.parametrize("unit", ["m", "mm", "arbitrary"])
def test_centres_are_as_sure_as_percents_of_the_rig_in_its_unit(unit, tmp_path):
    """Two cameras: the size of the rig is half of their distance. An arbitrary unit has none."""
    rig = studio(count=2)
    rig = rig.scale(1000.0, "mm") if unit == "mm" else replace(rig, unit=unit)
    path = judged(tmp_path, {"adjusted": True, "verdict": "usable"})
    mc.write(rig, tmp_path / "rig.yaml")
    tree = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    tree["provenance"] = JUDGED | {"centre_sigma_percent": {"cam0": 2.0, "cam1": 4.0}}
    path.write_text(yaml.safe_dump(tree))
    assert call("convert", "judged.yaml", "out.yaml", folder=tmp_path).status == 0
    cameras = yaml.safe_load((tmp_path / "out.yaml").read_text())["cameras"]
    sure = [each.get("centre_sigma") for each in cameras]
    size = np.linalg.norm(rig.centres[1] - rig.centres[0]) / 2
    if unit == "arbitrary":
        assert sure == [None, None]
    else:
        np.testing.assert_allclose(sure, [0.02 * size, 0.04 * size], rtol=0.005)


@pytest.mark.parametrize("name", CAMERAS)
def test_estimated_intrinsics_are_marked(name, tmp_path):
    first, *others = studio(name).cameras
    k1_sigma = 0.02 * (name == "anipose")
    estimated = EstimatedCamera.of(first, focal_sigma=SIGMA, k1_sigma=k1_sigma)
    mc.write(replace(studio(name), cameras=(estimated, *others)), tmp_path / "out", name)
    for content in contents(tmp_path / "out").values():
        said = (
            "camera cam0: intrinsics estimated from the recording, focal length 1000.0 +- 12.3 px"
        )
        assert (said.encode() in content) == (CAMERAS[name].verdict == "comment")
    back, other, _ = mc.read_cameras(tmp_path / "out")
    if name == "mocap-calib":
        assert (back.focal_sigma, back.k1_sigma) == (SIGMA, 0.0)
        assert type(other) is mc.Camera
    if name == "anipose":
        metadata = tomllib.loads((tmp_path / "out").read_text())["metadata"]
        expected = {"cam0": {"focal_sigma": SIGMA, "k1_sigma": 0.02}}
        assert metadata["estimated_intrinsics"] == expected


def test_stated_uncertainties_of_intrinsics_come_back(tmp_path):
    first, second, *others = studio("mocap-calib").cameras
    stated = replace(first, centre_sigma=2.5, focal_sigma=0.0)
    estimated = EstimatedCamera.of(
        replace(second, centre_sigma=0.1), focal_sigma=SIGMA, k1_sigma=0.0
    )
    rig = replace(studio("mocap-calib"), cameras=(stated, estimated, *others))
    mc.write(rig, tmp_path / "cameras.yaml")
    assert mc.read_rig(tmp_path / "cameras.yaml").cameras == rig.cameras
    tree = yaml.safe_load((tmp_path / "cameras.yaml").read_text("utf-8"))
    tree["cameras"][0]["focal_sigma"] = -1.0
    (tmp_path / "cameras.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    with pytest.raises(mc.FormatError, match="focal_sigma"):
        mc.read_cameras(tmp_path / "cameras.yaml")


@pytest.mark.parametrize("name", CAMERAS)
def test_no_zero_of_a_text_has_a_sign(name, tmp_path):
    """Not those that come of a product, such as the centre of a camera at the origin."""
    rig = studio(name)
    zeros = np.full((3, 3), -0.0)
    still = replace(rig, rotation=np.stack([np.eye(3)] * 3), translation=zeros)
    mc.write(still, tmp_path / "out", name)
    for content in contents(tmp_path / "out").values():
        assert not re.search(rb"-0(\.0*)?(?![\d.e])", content)


def test_a_unit_is_never_assumed_and_the_user_does_not_contradict_the_file(tmp_path):
    mc.write(studio(), tmp_path / "a.toml")
    assert mc.read_rig(tmp_path / "a.toml", unit="m").unit == "m"
    with pytest.raises(mc.MismatchError, match="as the file says"):
        mc.read_rig(tmp_path / "a.toml", unit="mm")
    mc.write(replace(studio(), unit="arbitrary"), tmp_path / "b.toml")
    with pytest.raises(mc.MismatchError, match="never scaled"):
        mc.read_rig(tmp_path / "b.toml", unit="mm")
    text = (tmp_path / "b.toml").read_text()
    for name, unit in (("c", ""), ("d", 'unit = "feet"')):
        (tmp_path / f"{name}.toml").write_text(text.replace('unit = "arbitrary"', unit))
    assert mc.read_rig(tmp_path / "c.toml", unit="mm").unit == "mm"
    with pytest.raises(mc.FormatError, match="a unit of length"):
        mc.read_rig(tmp_path / "d.toml")


def test_names_that_are_lost_are_reported(tmp_path):
    """Where cameras are counted from 0, and are not called so."""
    rig = studio("4d-association")
    named = [replace(each, name=str(k)) for k, each in enumerate(rig.cameras)]
    assert mc.write(rig, tmp_path / "a.json", "4d-association")
    assert not mc.write(replace(rig, cameras=tuple(named)), tmp_path / "b.json", "4d-association")


@pytest.mark.parametrize("name", [name for name, form in CAMERAS.items() if form.folder])
def test_a_folder_with_another_rig_is_refused(name, tmp_path):
    """Its files would be read along, whatever their endings."""
    for _ in range(2):
        mc.write(studio("opencv"), tmp_path / "cams", "opencv")
    cameras = [replace(each, name=f"other{k}") for k, each in enumerate(studio().cameras)]
    before = contents(tmp_path / "cams")
    with pytest.raises(mc.MismatchError, match=r"cam0\.yml"):
        mc.write(replace(studio(), cameras=tuple(cameras)), tmp_path / "cams", name)
    assert contents(tmp_path / "cams") == before


def test_the_folder_of_a_run_is_its_cameras(tmp_path):
    rig = studio()
    mc.write(rig, tmp_path / "cameras.yaml")
    mc.write(replace(rig, translation=-rig.translation), tmp_path / "calibration.toml")
    (tmp_path / "run.json").write_text("{}")
    assert_same(rig, mc.read_rig(tmp_path))


def test_the_table_has_every_format_that_is_written():
    with pytest.raises(mc.MismatchError) as refused:
        mc.write(studio(), "x", "no such format")
    named = set(re.search(r"formats (.+), found", str(refused.value))[1].split(", "))
    assert named - {"kalibr", "opencap", "ros"} == {*CAMERAS, *READ_ONLY}
