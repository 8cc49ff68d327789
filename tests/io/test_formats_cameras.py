"""Camera formats: what is written comes back, two formats of a rig agree, real files load, bad ones
are refused in a line.
"""

import io
import re
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from corruption import complaint
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs import assert_same, padded, rigs
from scipy.io import savemat

from mocap_calib.errors import FormatError, MismatchError, MocapCalibError
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras.formats import CAMERA_FORMATS
from mocap_calib.io.cameras.read import (
    load_cameras,
    make_rig,
    parse_content,
    read_cameras,
    read_rig,
)
from mocap_calib.io.cameras.source import Source
from mocap_calib.io.cameras.write import format_rig, write_cameras
from mocap_calib.io.conversion import convert_cameras
from mocap_calib.io.mat5 import read_mat
from mocap_calib.io.provenance import describe_judgement, judgement, read_judgement
from mocap_calib.io.registry import find_format
from mocap_calib.io.units import METRES
from mocap_calib.types import Camera, CameraRig, EstimatedCamera

SAMPLES = Path(__file__).parents[3] / "shared" / "formats" / "samples"
WRITTEN = [each.name for each in CAMERA_FORMATS if each.write]
# what a format carries: lengths of distortion, fisheyes, image sizes, one focal length
CARRIES = {
    "mocap-calib": ((0, 4, 5, 8), True, True, False),
    "anipose": ((0, 4, 5, 8), True, True, False),
    "opencv": ((0, 4, 5, 8), True, True, False),
    "colmap": ((0, 4, 5, 8), True, True, False),
    "colmap-binary": ((0, 4, 5, 8), True, True, False),
    "caliscope": ((0, 4, 5), True, True, False),
    "nerfstudio": ((0, 4, 5), True, True, False),
    "openmvg": ((0, 4, 5), True, True, True),
    "pose2sim": ((0, 4, 5, 8), False, True, False),
    "multiview-calib": ((0, 4, 5, 8), False, True, False),
    "freemocap": ((0, 4, 5), False, True, False),
    "easymocap": ((0, 4, 5), False, True, False),
    "panoptic": ((0, 4, 5), False, True, False),
    "jarvis": ((0, 4, 5), False, False, False),
    "voxelpose": ((0, 4, 5), False, False, False),
    "dannce": ((0, 4, 5), False, False, False),
    "4d-association": ((0,), False, True, False),
}
WITHOUT_UNIT = {"colmap-binary"}


def back(rig, name, provenance=None):
    """Written, and read again by what it looks like (files that JARVIS names its cameras by keep
    their names).
    """
    files = format_rig(rig, name, provenance or {}).files
    if not find_format(CAMERA_FORMATS, name).folder:
        return make_rig(parse_content(next(iter(files.values())), "file"), "file")
    return _from_folder(files, name)


def _from_folder(files, name):
    whole = Source("folder", files, folder=True)
    form = next((each for each in CAMERA_FORMATS if each.sniff(whole)), None)
    if form is not None:
        assert form.name == name
        found = form.read(whole)
        return make_rig(replace(found, unit=found.unit or form.unit), "folder")
    parts = [make_rig(parse_content(content, file), file) for file, content in files.items()]
    return CameraRig(
        sum((p.cameras for p in parts), ()),
        np.concatenate([p.rotation for p in parts]),
        np.concatenate([p.translation for p in parts]),
        parts[0].unit,
    )


def test_every_written_format_is_in_the_table_here():
    assert set(WRITTEN) == set(CARRIES)


@pytest.mark.parametrize("name", WRITTEN)
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_what_is_written_comes_back(name, data):
    lengths, fisheye, sizes, square = CARRIES[name]
    unit = find_format(CAMERA_FORMATS, name).unit
    rig = data.draw(
        rigs(
            lengths,
            fisheye,
            square=square,
            units=tuple(METRES) if unit else ("m", "mm", "arbitrary"),
        )
    )
    found = back(rig, name, {"seed": 0, "path": "a b", "none": None})
    assert found.unit == ("arbitrary" if name in WITHOUT_UNIT else unit or rig.unit)
    scale = METRES[rig.unit] / METRES[unit] if unit else 1.0
    assert_same(rig, found, sizes=sizes, names=name != "4d-association", scale=scale)


JUDGED = judgement(
    "not determined",
    ["inconsistent: zo\u00eb's: 'left'"],
    3.25,
    centre_sigma_percent={"zo\u00eb's": 1.5, "1": 0.25},
    rotation_sigma_deg={"zo\u00eb's": 0.5},
)
WITHOUT_ROOM = {"colmap-binary", "dannce", "multiview-calib", "voxelpose", "4d-association"}
WITHOUT_COMMENTS = {*WITHOUT_ROOM, "nerfstudio", "openmvg", "panoptic"}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_rig_that_is_not_determined_says_so_in_every_file_that_has_comments(name):
    """And the cameras read as they did."""
    rig = studio(name)
    plain = format_rig(rig, name, {}).files
    judged = format_rig(rig, name, JUDGED).files
    if name in WITHOUT_COMMENTS:
        assert (judged == plain) == (name in WITHOUT_ROOM)
        return
    for content in judged.values():
        assert (
            "# mocap-calib: this rig is not determined: do not measure with it\n"
            "#   inconsistent: zo\u00eb's: 'left'\n"
        ) in content.decode()
    found, expected = back(rig, name, JUDGED), back(rig, name)
    np.testing.assert_array_equal(found.rotation, expected.rotation)
    np.testing.assert_array_equal(found.translation, expected.translation)
    assert found.names == expected.names


@pytest.mark.parametrize("name", sorted(set(WRITTEN) - WITHOUT_COMMENTS))
def test_estimated_intrinsics_are_said_in_every_file_that_has_comments(name):
    rig = studio(name)
    first, *others = rig.cameras
    fields = {key: getattr(first, key) for key in Camera.__dataclass_fields__}
    estimated = EstimatedCamera(**fields, focal_sigma=12.34, k1_sigma=0.0)
    for content in format_rig(replace(rig, cameras=(estimated, *others)), name, {}).files.values():
        assert (
            f"# camera {first.name}: intrinsics estimated from the recording, "
            f"focal length {first.focal:.1f} +- 12.3 px\n"
        ) in content.decode()


@pytest.mark.parametrize("name", sorted({"opencv", "easymocap", "jarvis"}))
def test_opencv_reads_files_with_a_comment(name, tmp_path):
    for file, content in format_rig(studio(name), name, JUDGED).files.items():
        (tmp_path / file).write_bytes(content)
        storage = cv2.FileStorage(str(tmp_path / file), cv2.FILE_STORAGE_READ)
        assert storage.isOpened()
        assert storage.root().keys()


@pytest.mark.parametrize("name", WRITTEN)
def test_no_zero_of_a_text_file_has_a_sign(name):
    """Not those that come of a product, such as the centre of a camera at the origin."""
    rig = studio(name)
    zeros = np.full((len(rig.cameras), 3), -0.0)
    still = replace(rig, rotation=np.stack([np.diag([1.0, 1, 1])] * len(zeros)), translation=zeros)
    files = format_rig(still, name, {}).files
    assert not [
        file for file, content in files.items() if re.search(rb"-0(\.0*)?(?![\d.e])", content)
    ]


@pytest.mark.parametrize("name", ["mocap-calib", "anipose"])
@pytest.mark.parametrize("target", ["anipose", "pose2sim", "mocap-calib"])
def test_a_conversion_hands_the_verdict_on(name, target):
    (content,) = format_rig(studio(name), name, JUDGED).files.values()
    assert parse_content(content, "file").judgement == JUDGED
    (converted,) = convert_cameras(content, None, target, unit="m").files.values()
    assert b"# mocap-calib: this rig is not determined" in converted
    assert b"#   inconsistent: zo" in converted


@pytest.mark.parametrize("name", WRITTEN)
def test_a_conversion_reads_the_verdict_wherever_there_is_room_for_it(name, tmp_path):
    """Where there is none, that is said. Comments have the error in a remark, in words."""
    rig = studio(name)
    lost = write_cameras(tmp_path / "out", rig, name, JUDGED)
    assert ("the verdict on the rig" in lost) == (name in WITHOUT_ROOM)
    said = dict(load_cameras(tmp_path / "out").judgement)
    if name in WITHOUT_ROOM:
        assert said == {}
        return
    assert said in (JUDGED, {key: JUDGED[key] for key in ("adjusted", "verdict", "remarks")})
    convert_cameras(tmp_path / "out", tmp_path / "again.toml", "anipose")
    again = load_cameras(tmp_path / "again.toml").judgement
    assert again == load_cameras(tmp_path / "out").judgement


def test_a_comment_of_another_word_is_no_verdict():
    content = b"# mocap-calib: this rig is splendid\n#   remark\n"
    rig = format_rig(studio("anipose"), "anipose", {}).files
    (plain,) = rig.values()
    assert parse_content(content + plain, "file").judgement == {}


@pytest.mark.parametrize(
    ("edited", "kept"),
    [
        ("nothing of the kind", {}),
        ({"verdict": "excellent", "adjusted": "yes"}, {}),
        ({"remarks": ["a\nb: 1", 3, "fine"], "verdict": "weak"}, {"remarks": ["fine"]}),
        ({"reprojection_error_px": float("nan")}, {}),
        ({"centre_sigma_percent": {"a": 1.0}}, {"centre_sigma_percent": {"a": 1.0}}),
        ({"centre_sigma_percent": {"a": -1.0}}, {}),
        ({"rotation_sigma_deg": {"a": 1.0, "b": "small"}}, {}),
    ],
)
def test_an_edited_judgement_makes_no_false_comment(edited, kept):
    found = read_judgement(edited)
    found.pop("verdict", None)
    assert found == kept
    assert not any("\n" in line for line in describe_judgement(read_judgement(edited)))


@pytest.mark.parametrize("name", WRITTEN)
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_what_cannot_be_carried_is_refused_in_a_line(name, data):
    lengths, fisheye, _, square = CARRIES[name]
    rig = data.draw(rigs(units=("m",)))
    kept = all(
        (camera.fisheye and fisheye)
        or (not camera.fisheye and not padded(camera)[max(lengths) :].any())
        for camera in rig.cameras
    )
    kept &= not square or all(abs(c.matrix[0, 0] / c.matrix[1, 1] - 1) < 1e-4 for c in rig.cameras)
    message = complaint(lambda: format_rig(rig, name, {}))
    assert (message == "") == kept
    assert kept or (
        "expected" in message
        and "found" in message
        and any(f"camera {n}" in message for n in rig.names)
    )


@pytest.mark.parametrize("name", WRITTEN)
def test_the_same_rig_in_two_formats_projects_alike(name):
    """Through the formats' own conventions to pixels: 1e-6 px at 4 m and f = 1000 px (measured
    2e-9).
    """
    rig = studio(name)
    found = back(rig, name)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, size=(30, 3))
    scale = METRES[rig.unit] / METRES[found.unit] if found.unit in METRES else 1.0
    for v in range(len(rig.cameras)):
        before = pixels_from_points(rig.cameras[v], points @ rig.rotation[v].T + rig.translation[v])
        after = pixels_from_points(
            found.cameras[v], points * scale @ found.rotation[v].T + found.translation[v]
        )
        assert np.isfinite(before).all()
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-6)


def studio(name):
    lens = np.zeros(5) if name == "4d-association" else np.array([-0.1, 0.02, 1e-3, -2e-3, 1e-3])
    matrix = np.array([[1000.0, 0, 640], [0, 1000, 360], [0, 0, 1]])
    cameras = tuple(Camera(f"cam{k}", (1280, 720), matrix, lens, False) for k in range(3))
    turns = matrix_from_vector(np.array([[0.1, a, 0.05] for a in (0.0, 1.5, 3.0)]))
    return CameraRig(cameras, turns, np.tile([0.1, -0.2, 4.0], (3, 1)), "m")


def test_names_that_are_lost_are_said():
    """Where cameras are counted from 0, and are not called so."""
    rig = replace(studio("4d-association"), unit="m")
    numbered = replace(
        rig, cameras=tuple(replace(each, name=str(k)) for k, each in enumerate(rig.cameras))
    )
    for each, expected in ((rig, True), (numbered, False)):
        lost = format_rig(each, "4d-association", {}).lost
        assert any("names" in words for words in lost) == expected


def test_a_unit_is_never_assumed():
    rig = replace(studio("anipose"), unit="arbitrary")
    for name in WRITTEN:
        if find_format(CAMERA_FORMATS, name).unit:
            with pytest.raises(MismatchError, match="mocap-calib scale"):
                format_rig(rig, name, {})
        else:
            assert back(rig, name).unit == "arbitrary"


def test_the_users_unit_does_not_contradict_the_file(tmp_path):
    write_cameras(tmp_path / "a.toml", studio("anipose"), "anipose")
    assert read_rig(tmp_path / "a.toml", unit="m").unit == "m"
    with pytest.raises(MismatchError, match="as the file says"):
        read_rig(tmp_path / "a.toml", unit="mm")
    write_cameras(tmp_path / "b.toml", replace(studio("anipose"), unit="arbitrary"), "anipose")
    with pytest.raises(MismatchError, match="never scaled"):
        read_rig(tmp_path / "b.toml", unit="mm")
    silent = (tmp_path / "b.toml").read_text().replace('unit = "arbitrary"', "")
    (tmp_path / "b.toml").write_text(silent)
    assert read_rig(tmp_path / "b.toml", unit="mm").unit == "mm"


@pytest.mark.parametrize("name", WRITTEN)
def test_files_are_recognised_and_written_the_same_twice(name, tmp_path):
    rig = studio(name)
    for k in range(2):
        write_cameras(tmp_path / f"{k}", rig, name)
    one, two = (
        {f.name: f.read_bytes() for f in ([p] if p.is_file() else p.iterdir())}
        for p in (tmp_path / "0", tmp_path / "1")
    )
    assert sorted(one.values()) == sorted(two.values())
    assert len(load_cameras(tmp_path / "0").cameras) == 3


def test_a_folder_with_another_rig_is_refused(tmp_path):
    write_cameras(tmp_path / "cams", studio("opencv"), "opencv")
    write_cameras(tmp_path / "cams", studio("opencv"), "opencv")
    other = studio("opencv")
    other = replace(
        other,
        cameras=tuple(replace(camera, name=f"other{k}") for k, camera in enumerate(other.cameras)),
    )
    with pytest.raises(MismatchError, match=r"cam0\.yml"):
        write_cameras(tmp_path / "cams", other, "opencv")
    for name in (
        "easymocap",
        "jarvis",
        "multiview-calib",
        "colmap",
    ):  # whose files would be read along, whatever their endings
        with pytest.raises(MismatchError, match=r"cam0\.yml"):
            write_cameras(tmp_path / "cams", replace(studio("opencv"), unit="m"), name)
    assert len(load_cameras(tmp_path / "cams").cameras) == 3


@pytest.mark.parametrize(
    "text", ["\n" * 200_000, " \n" * 100_000, "[" * 200_000, "a" * 1_000_000, "a:\n" * 100_000]
)
def test_long_nothings_are_refused_at_once(text):
    begun = time.process_time()
    assert complaint(lambda: parse_content(text.encode(), "x"))
    assert time.process_time() - begun < 20  # a megabyte of YAML: 3 s


def test_dannce_s_files_of_one_camera_each_are_its_file_of_all(tmp_path):
    rig = studio("dannce")
    write_cameras(tmp_path / "all.mat", rig, "dannce")
    (tmp_path / "each").mkdir()
    for camera, rotation, translation in zip(
        rig.cameras, rig.rotation, rig.translation, strict=True
    ):
        k1, k2, p1, p2, k3 = [*camera.distortion, *[0.0] * 5][:5]
        fields = {
            "K": camera.matrix.T,
            "RDistort": [k1, k2, k3],
            "TDistort": [p1, p2],
            "r": rotation.T,
            "t": 1000 * translation[None],
        }
        savemat(tmp_path / "each" / f"hires_{camera.name}_params.mat", fields)
    one, other = read_rig(tmp_path / "all.mat"), read_rig(tmp_path / "each")
    assert (other.names, other.unit) == (one.names, one.unit)
    assert_same(one, other)
    savemat(tmp_path / "no.mat", {"K": np.eye(3)})
    with pytest.raises(FormatError, match="give the file that has the cameras"):
        read_rig(tmp_path / "no.mat")


@pytest.mark.parametrize("compressed", [False, True])
def test_a_matlab_file_that_ends_early_is_no_whole_file(compressed):
    content = io.BytesIO()
    savemat(content, {"K": np.arange(9.0).reshape(3, 3)}, do_compression=compressed)
    whole = content.getvalue()
    np.testing.assert_array_equal(read_mat(whole, ("K",))["K"], np.arange(9.0).reshape(3, 3))
    for end in (len(whole) - 1, len(whole) - 16):
        with pytest.raises(ValueError, match="beyond the end"):
            read_mat(whole[:end], ("K",))


def test_a_crowd_of_values_is_refused_before_all_are_read():
    """Camera files are small; a megabyte of numbers took PyYAML 20 s and 400 MB, fifty thousand
    take it 2 s.
    """
    assert "50000 values" in complaint(
        lambda: parse_content(b"camera_matrix: [" + b"1," * 500_000 + b"1]\n", "x")
    )


# --- what other programs wrote

REAL = {
    "caliscope/camera_array.toml": (4, 4, "m"),
    "caliscope/base_data_camera_array.toml": (4, 4, "m"),
    "caliscope/charuco_camera_array.toml": (4, 4, "m"),
    "caliscope/config.toml": (4, 4, "arbitrary"),
    "easymocap/intri_excerpt.yml": (5, 0, "m"),
    "jarvis_yaml/cam_01.yaml": (1, 1, "mm"),
    "kalibr/camchain.yaml": (2, 2, "m"),
    "nerfstudio/transforms.json": (4, 4, "arbitrary"),
    "opencv_yaml/cam_01_cv5.yml": (1, 1, "arbitrary"),
    "openmvg/sfm_data.json": (4, 4, "arbitrary"),
    "panoptic_calib/4da_shelf_calibration.json": (5, 5, "m"),
    "panoptic_calib/calibration_campus.json": (3, 3, "mm"),
    "panoptic_calib/calibration_shelf.json": (5, 5, "mm"),
    "panoptic_calib/fastervoxelpose_demo_calibration.json": (5, 5, "mm"),
    "pose2sim_toml/Calib_qualisys.toml": (4, 4, "m"),
    "ros_camera_info/astra.yaml": (1, 0, "arbitrary"),
    "sleap_anipose_session/calibration.toml": (4, 4, "arbitrary"),
    "lightning_pose_csv/calibration.toml": (3, 3, "arbitrary"),
    "colmap/txt": (4, 4, "arbitrary"),
    "colmap/bin": (4, 4, "arbitrary"),
    "dannce_mat/label3d_dannce.mat": (6, 6, "mm"),
    "dannce_mat/label3d_demo.mat": (6, 6, "mm"),
    "more/sleap_8cam_calibration.toml": (8, 8, "arbitrary"),
}
REFUSED = {
    "caliscope/charuco.toml": "sections with a camera",
    "dannce_mat/com3d.mat": "params",
    "easymocap/extri_excerpt.yml": r"called extri\.yml, beside its intri\.yml",
    "kalibr_like/camera_intrinsics.yaml": "camera_model",
    "kalibr_like/camera_extrinsics_reference.yaml": "one of",
    "opencv_yaml/cam_cv4.yml": "a camera matrix",
    "opensfm/reconstruction_example.json": "one of",
    "pymvg/pymvg_camsystem.json": "one of",
    "more/acinoset_scene_sba.json": "one of",
    "pose2sim_toml/Calib.qca.txt": "one of",
}
needs_samples = pytest.mark.skipif(not SAMPLES.is_dir(), reason="the sample files are not here")


@needs_samples
@pytest.mark.parametrize("path", REAL)
def test_real_files_load(path):
    found = load_cameras(SAMPLES / path)
    assert (len(found.cameras), len(found.extrinsics), found.unit) == REAL[path]


@needs_samples
@pytest.mark.parametrize("path", REFUSED)
def test_other_files_are_refused_for_a_reason(path):
    with pytest.raises(FormatError, match=REFUSED[path]):
        load_cameras(SAMPLES / path)


@needs_samples
def test_one_real_rig_in_seven_formats_is_one_rig():
    """The samples were made of the Pose2Sim one by other programs; what each cannot hold is left
    out (tangential terms, digits).
    """
    first = load_cameras(SAMPLES / "pose2sim_toml/Calib_qualisys.toml")
    name = "cam_01"
    rotation, translation = first.extrinsics[name]
    for path, scale, called in (
        ("nerfstudio/transforms.json", 1, name),
        ("openmvg/sfm_data.json", 1, name),
        ("colmap/txt", 1, name),
        ("colmap/bin", 1, name),
    ):
        found = load_cameras(SAMPLES / path)
        np.testing.assert_allclose(found.extrinsics[called][0], rotation, atol=1e-9)
        np.testing.assert_allclose(found.extrinsics[called][1], translation * scale, atol=1e-9)
        np.testing.assert_allclose(
            found.cameras[0].matrix[:2, 2], first.cameras[0].matrix[:2, 2], atol=1e-9
        )
    for path, scale in (("jarvis_yaml/cam_01.yaml", 1000), ("opencv_yaml/cam_01_cv5.yml", 1)):
        (pose,) = load_cameras(SAMPLES / path).extrinsics.values()
        np.testing.assert_allclose(pose[0], rotation, atol=1e-9)
        np.testing.assert_allclose(pose[1], translation * scale, atol=1e-6)


@needs_samples
def test_voxelpose_and_4d_association_agree_on_the_shelf():
    """Two data sets' files of one rig, rounded to 6 digits: centres within 1 mm (measured 0.02)."""
    voxel, four = (
        make_rig(load_cameras(SAMPLES / "panoptic_calib" / f), f)
        for f in ("calibration_shelf.json", "4da_shelf_calibration.json")
    )
    np.testing.assert_allclose(voxel.centres, four.centres * 1000, atol=1.0)


@needs_samples
def test_real_points_are_seen_where_they_were_clicked():
    """Label3D's own 3D through its cameras, transposed matrices and millimetres: 0.14 to 0.92 px
    (transposed wrongly: hundreds).
    """
    path = SAMPLES / "dannce_mat/label3d_dannce.mat"
    rig = make_rig(load_cameras(path), "x")
    labels = read_mat(path.read_bytes(), ("labelData",))["labelData"]
    for v, camera in enumerate(rig.cameras):
        points, clicked = (
            np.asarray(labels[v][0][name]).reshape(81, 22, -1) for name in ("data_3d", "data_2d")
        )
        apart = np.linalg.norm(
            pixels_from_points(camera, points @ rig.rotation[v].T + rig.translation[v]) - clicked,
            axis=-1,
        )
        assert np.nanmedian(apart) < 1.5


@needs_samples
def test_what_is_odd_is_said():
    assert any(
        "side and top" in note
        for note in load_cameras(SAMPLES / "sleap_anipose_session/calibration.toml").notes
    )
    assert any(
        "camera 0 has no intrinsics" in note
        for note in load_cameras(SAMPLES / "caliscope/base_data_camera_array.toml").notes
    )
    assert any(
        "skew" in note for note in load_cameras(SAMPLES / "dannce_mat/label3d_dannce.mat").notes
    )


# --- damage


@pytest.mark.parametrize("name", [each.name for each in CAMERA_FORMATS])
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"[]",
        b"[cameras]",
        b"null",
        b"- 1\n",
        b"a: 1\n",
        b"%YAML:1.0\n---\n",
        b"MATLAB 5.0",
        b"\x89HDF\r\n",
        b"\x00" * 600,
    ],
)
def test_a_format_that_is_named_refuses_what_is_not_it(name, content):
    with pytest.raises(MocapCalibError) as caught:
        parse_content(content, "somewhere", name)
    assert "expected" in str(caught.value)


def test_what_cannot_be_camera_yaml():
    bomb = (
        "a: &a [1, 1]\n"
        + "".join(f"{c}: &{c} [*{p}, *{p}]\n" for p, c in zip("abcdefg", "bcdefgh", strict=True))
        + "K: *h\n"
    )
    for text, reason in (
        (bomb, "alias"),
        ("K: 1\nK: 2\n", "twice"),
        ("K: " + "[1]," * 1_100_000, "below 2 MB"),
    ):
        with pytest.raises(FormatError, match=reason):
            parse_content(text.encode(), "x.yaml")


@pytest.mark.parametrize("text", ["- intrinsics\n- b\n", "intrinsics\n", "cameras: intrinsics\n"])
def test_words_of_a_format_do_not_make_a_file_of_it(text, tmp_path):
    path = tmp_path / "cameras.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FormatError, match="expected cameras, one of: mocap-calib, "):
        read_cameras(path)
