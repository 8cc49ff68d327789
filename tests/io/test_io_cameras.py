"""Camera files: what is written comes back, what others write is read, what is wrong is refused in
one line.
"""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mocap_calib.errors import FormatError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras import read
from mocap_calib.io.cameras.own import (
    format_calibration_toml,
    format_cameras_yaml,
)
from mocap_calib.io.cameras.read import read_cameras, read_rig
from mocap_calib.io.cameras.write import write_cameras
from mocap_calib.io.provenance import hold_for, judgement
from mocap_calib.recording.names import compose_name
from mocap_calib.types import Camera, CameraRig, EstimatedCamera

PROVENANCE = {
    "seed": 0,
    "inputs": {"a b.json": "0f"},
    "list": [1, 2.5, "x"],
    "none": None,
    "quick": True,
}


def make_rig(seed=0, names=("cam_10", "cam_2"), vectors=None, fisheye=False):
    rng = np.random.default_rng(seed)
    cameras = []
    for k, name in enumerate(names):
        matrix = np.array(
            [
                [rng.uniform(1e-5, 1e5), 0, rng.normal() * 1e3],
                [0, rng.uniform(100, 2000), rng.normal()],
                [0, 0, 1],
            ]
        )
        cameras.append(
            Camera(
                name,
                (640 + k, 480),
                matrix,
                rng.normal(size=4 if fisheye else (4, 5, 8)[k % 3]) * 10.0 ** rng.integers(-8, 3),
                fisheye,
            )
        )
    vectors = (
        rng.normal(size=(len(names), 3)) if vectors is None else np.asarray(vectors, dtype=float)
    )
    return CameraRig(
        tuple(cameras), matrix_from_vector(vectors), rng.normal(size=(len(names), 3)), "m"
    )


def parse_cameras(text, source):
    """`read_cameras` on text; `source` stands for the file's path."""
    return read.parse_content(text.encode(), source).cameras


def parse_rig(text, source):
    """`read_rig` on text; `source` stands for the file's path."""
    return read.make_rig(read.parse_content(text.encode(), source), source)


def same_cameras(first, second):
    assert [c.name for c in first] == [c.name for c in second]
    for a, b in zip(first, second, strict=True):
        assert (a.size, a.fisheye) == (b.size, b.fisheye)
        np.testing.assert_array_equal(a.matrix, b.matrix)
        np.testing.assert_array_equal(a.distortion, b.distortion)


NAME = st.text(min_size=1, max_size=8).map(compose_name)  # as names are compared
NAMES = st.lists(NAME, min_size=1, max_size=5, unique=True)


@settings(max_examples=25, deadline=None)
@example(seed=0, names=["\n="], fisheye=False)
@given(seed=st.integers(0, 10**6), names=NAMES, fisheye=st.booleans())
def test_our_yaml_comes_back_exactly(seed, names, fisheye):
    rig = make_rig(seed, names, fisheye=fisheye)
    text = format_cameras_yaml(rig, PROVENANCE)
    back = parse_rig(text, "text")
    same_cameras(rig.cameras, back.cameras)
    same_cameras(rig.cameras, parse_cameras(text, "text"))
    np.testing.assert_array_equal(back.rotation, rig.rotation)
    np.testing.assert_array_equal(back.translation, rig.translation)
    assert back.unit == rig.unit


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), NAMES, st.booleans())
def test_anipose_toml_comes_back(seed, names, fisheye):
    rig = make_rig(seed, names, fisheye=fisheye)
    back = parse_rig(format_calibration_toml(rig, PROVENANCE), "text")
    same_cameras(rig.cameras, back.cameras)
    # measured 1.6e-15 over 2000 rigs: a vector and back
    np.testing.assert_allclose(back.rotation, rig.rotation, rtol=0, atol=5e-15)
    np.testing.assert_array_equal(back.translation, rig.translation)
    assert back.unit == rig.unit


@pytest.mark.parametrize(
    "vector",
    [
        (0, 0, 0),
        (np.pi, 0, 0),
        (0, -np.pi, 0),
        (1e-9, 0, 0),
        (np.pi / np.sqrt(2), -np.pi / np.sqrt(2), 0),
    ],
)
def test_anipose_toml_keeps_no_turn_and_half_a_turn(vector):
    rig = make_rig(vectors=[vector, vector])
    np.testing.assert_allclose(
        parse_rig(format_calibration_toml(rig, {}), "text").rotation,
        rig.rotation,
        rtol=0,
        atol=1e-14,
    )


def test_our_yaml_is_plain_and_says_its_convention():
    rig = make_rig()
    text = format_cameras_yaml(rig, PROVENANCE)
    data = yaml.safe_load(text)
    assert list(data) == ["format", "version", "unit", "convention", "provenance", "cameras"]
    assert list(data["cameras"][0]) == [
        "name",
        "size",
        "model",
        "K",
        "distortion",
        "R",
        "t",
        "centre",
    ]
    np.testing.assert_allclose(data["cameras"][1]["centre"], rig.centres[1])
    assert data["provenance"] == PROVENANCE
    assert "- [0.0, 0.0, 1.0]" in text


def test_our_yaml_says_the_offsets_of_clocks_beside_the_cameras():
    rig = make_rig()
    name = rig.names[1]
    text = format_cameras_yaml(rig, {**PROVENANCE, "clock_subframe_offset": {name: -0.45}})
    fields = yaml.safe_load(text)
    assert "clock_subframe_offset" not in fields["provenance"]
    assert [each.get("clock_subframe_offset") for each in fields["cameras"]] == [None, -0.45]
    assert parse_rig(text, "cameras.yaml").names == rig.names


def test_anipose_toml_has_the_keys_that_others_read():
    rig = make_rig()
    data = tomllib.loads(format_calibration_toml(rig, PROVENANCE))
    assert list(data) == ["cam_0", "cam_1", "metadata"]
    assert list(data["cam_0"]) == [
        "name",
        "size",
        "matrix",
        "distortions",
        "rotation",
        "translation",
    ]
    assert {k: data["metadata"].get(k) for k in ("adjusted", "error", "unit")} == {
        "adjusted": False,
        "error": None,
        "unit": "m",
    }
    assert data["metadata"]["provenance"] == {k: v for k, v in PROVENANCE.items() if v is not None}
    assert (
        tomllib.loads(format_calibration_toml(make_rig(fisheye=True), {}))["cam_0"]["fisheye"]
        is True
    )


def estimated_rig(focal_sigma: object = 12.5, k1_sigma: object = 0.0) -> CameraRig:
    """A rig whose second camera's intrinsics were estimated."""
    rig = make_rig()
    given_, guessed = rig.cameras
    fields = {key: getattr(guessed, key) for key in Camera.__dataclass_fields__}
    estimated = EstimatedCamera(**fields, focal_sigma=focal_sigma, k1_sigma=k1_sigma)
    return replace(rig, cameras=(given_, estimated))


def test_estimated_intrinsics_are_marked_and_come_back():
    rig = estimated_rig(focal_sigma=12.5, k1_sigma=0.02)
    text = format_cameras_yaml(rig, PROVENANCE)
    first, second = yaml.safe_load(text)["cameras"]
    assert "estimated" not in first
    assert second["estimated"] == {"focal_sigma": 12.5, "k1_sigma": 0.02}
    first, second = parse_cameras(text, "text")
    assert type(first) is Camera
    assert (second.focal_sigma, second.k1_sigma) == (12.5, 0.02)

    toml = format_calibration_toml(rig, PROVENANCE)
    expected = {"cam_2": {"focal_sigma": 12.5, "k1_sigma": 0.02}}
    assert tomllib.loads(toml)["metadata"]["estimated_intrinsics"] == expected
    assert len(parse_cameras(toml, "text")) == 2


@pytest.mark.parametrize("sigma", [-1.0, float("nan"), "wide", [1.0, 2.0]])
def test_a_sigma_that_cannot_be_is_refused(sigma):
    text = format_cameras_yaml(estimated_rig(focal_sigma=sigma), PROVENANCE)
    with pytest.raises(FormatError, match="focal_sigma and k1_sigma of 0 or more"):
        parse_cameras(text, "text")


def test_places_are_as_sure_as_percents_of_the_rig_in_its_unit():
    """Two cameras: the size of the rig is half of their distance. An arbitrary unit has none."""
    rig = make_rig()
    first = rig.names[0]
    percent = {first: 2.0, rig.names[1]: 4.0}
    provenance = judgement("usable", [], None, centre_sigma_percent=percent)
    size = np.linalg.norm(rig.centres[1] - rig.centres[0]) / 2
    for known, sure in ((rig, 0.02 * size), (rig.scale(1000.0, "mm"), 20 * size)):
        described = yaml.safe_load(format_cameras_yaml(known, provenance))["cameras"]
        assert described[0]["centre_sigma"] == pytest.approx(sure, rel=0.005)
        assert described[1]["centre_sigma"] == pytest.approx(2 * sure, rel=0.005)


def test_percents_of_another_rig_or_edited_ones_say_no_lengths():
    """Of a part of the rig, of cameras that stood elsewhere for some time, of an arbitrary unit."""
    rig = make_rig()
    percent = dict.fromkeys(rig.names, 2.0)
    provenance = judgement("usable", [], None, centre_sigma_percent=percent)
    edited = provenance | {"centre_sigma_percent": {**percent, rig.names[0]: "small"}}
    for part, said in (
        (rig.select([0]), provenance),
        (rig, hold_for(provenance, (0, 9))),
        (rig, edited),
        (replace(rig, unit="arbitrary"), provenance),
    ):
        assert "centre_sigma:" not in format_cameras_yaml(part, said)


def test_anipose_toml_of_an_adjusted_rig_says_so_and_its_error():
    """As anipose does for cameras that were adjusted to the animal, which it keeps as they are."""
    provenance = {"command": "mocap-calib run", **judgement("weak", [], 1.5)}
    metadata = tomllib.loads(format_calibration_toml(make_rig(), provenance))["metadata"]
    assert (metadata["adjusted"], metadata["error"]) == (True, 1.5)
    unknown = tomllib.loads(format_calibration_toml(make_rig(), judgement("weak", [], None)))
    assert unknown["metadata"]["adjusted"] is True
    assert "error" not in unknown["metadata"]


def test_files_are_the_same_bytes_every_time(tmp_path):
    for k in range(2):
        write_cameras(tmp_path / f"{k}.yaml", make_rig(), "mocap-calib", PROVENANCE)
        write_cameras(tmp_path / f"{k}.toml", make_rig(), "anipose", PROVENANCE)
    assert (tmp_path / "0.yaml").read_bytes() == (tmp_path / "1.yaml").read_bytes()
    assert (tmp_path / "0.toml").read_bytes() == (tmp_path / "1.toml").read_bytes()
    same_cameras(read_cameras(tmp_path / "0.yaml"), read_rig(tmp_path / "0.toml").cameras)


# --- what other programs write

SECTION = """
[{section}]
size = [640.0, 480.0]
matrix = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.2, 0.0, 0.0]
"""
POSED = SECTION + "rotation = [0.0, 0.0, {angle}]\ntranslation = [1.0, 2.0, 3.0]\n"


def test_a_section_may_have_any_name_and_lie_below_another():
    text = (
        POSED.format(section="left", angle=0.0)
        + POSED.format(section="cameras.7", angle=0.0)
        + "[board]\nkind = 'charuco'\n[metadata]\nunit = 'mm'\n"
    )
    rig = parse_rig(text, "text")
    assert rig.names == ("left", "7")
    assert rig.unit == "mm"
    assert rig.cameras[0].size == (640, 480)


def test_a_rotation_may_be_a_matrix():
    turned = SECTION.format(section="a") + (
        "rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n"
        "translation = [0.0, 0.0, 0.0]\n"
    )
    np.testing.assert_allclose(
        parse_rig(turned, "t").rotation,
        parse_rig(POSED.format(section="a", angle=np.pi / 2), "t").rotation,
        atol=1e-15,
    )


def test_intrinsics_alone_are_no_rig():
    text = (
        POSED.format(section="a", angle=0.0) + SECTION.format(section="b") + 'rotation = "null"\n'
    )
    assert len(parse_cameras(text, "t")) == 2
    with pytest.raises(FormatError, match=r"extrinsics .* none of b"):
        parse_rig(text, "t")


def opencv(name="K", header="%YAML:1.0\n---\n", extra="", distortion="[ 0.1, -0.2, 0., 1e-3, 0. ]"):
    size = "image_width: 640\nimage_height: 480\n"
    matrix = (
        f"{name}: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        f"   data: [ 500., 0., 320., 0., 501., 240., 0., 0., 1. ]\n"
    )
    return (
        header
        + size
        + matrix
        + f"D: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: {distortion}\n"
        + extra
    )


@pytest.mark.parametrize(
    "header", ["%YAML:1.0\n---\n", "%YAML 1.2\n---\n", "%YAML:1.0\r\n---\r\n", ""]
)
@pytest.mark.parametrize("name", ["camera_matrix", "K", "M1"])
def test_opencv_yaml_of_every_header_and_name(header, name, tmp_path):
    path = tmp_path / "left.yml"
    path.write_text(opencv(name, header))
    (camera,) = read_cameras(path)
    assert (camera.name, camera.size, camera.fisheye) == ("left", (640, 480), False)
    np.testing.assert_array_equal(camera.matrix, [[500, 0, 320], [0, 501, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [0.1, -0.2, 0, 1e-3, 0])


def test_a_folder_of_opencv_files_is_a_rig(tmp_path):
    pose = "{k}: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 0., {v}, 0. ]\n"
    for name, angle in (("b", 0.5), ("a", -0.5)):
        (tmp_path / f"{name}.yaml").write_text(
            opencv(extra=pose.format(k="rvec", v=angle) + pose.format(k="tvec", v=2.0))
        )
    (tmp_path / "notes.txt").write_text("not a camera")
    rig = read_rig(tmp_path)
    assert rig.names == ("a", "b")
    np.testing.assert_allclose(
        rig.rotation, matrix_from_vector(np.array([[0, -0.5, 0], [0, 0.5, 0]])), atol=1e-15
    )
    (tmp_path / "c.yaml").write_text(opencv(extra="camera_name: a\n"))
    with pytest.raises(FormatError, match="each camera name once"):
        read_cameras(tmp_path)


def test_ros_camera_info_is_read():
    text = (
        "image_width: 640\nimage_height: 480\ncamera_name: rgb\ncamera_matrix:\n"
        "  rows: 3\n  cols: 3\n  data: [500, 0, 320, 0, 501, 240, 0, 0, 1]\n"
    )
    text += (
        "distortion_model: equidistant\ndistortion_coefficients:\n"
        "  rows: 1\n  cols: 4\n  data: [0.1, 0, 0, 0]\n"
    )
    (camera,) = parse_cameras(text, "x.yaml")
    assert (camera.name, camera.size, camera.fisheye) == ("rgb", (640, 480), True)


def test_what_a_file_leaves_out():
    text = (
        "%YAML:1.0\n---\n"
        + opencv(header="").split("K:")[1].join(["K:", ""]).split("D:", maxsplit=1)[0]
    )
    (camera,) = parse_cameras(text, "x.yml")
    assert camera.size == (0, 0)
    np.testing.assert_array_equal(camera.distortion, np.zeros(5))


@pytest.mark.parametrize(
    ("given_", "fisheye", "kept"),
    [
        *(
            ([], False, [0] * 5),
            ([0.1], False, [0.1, 0, 0, 0, 0]),
            ([0.1, 0.2], False, [0.1, 0.2, 0, 0, 0]),
            ([1, 2, 3, 4], False, [1, 2, 3, 4]),
        ),
        *(
            ([1, 2, 3, 4, 5, 0], False, [1, 2, 3, 4, 5]),
            ([[1, 2, 3, 4, 5]], False, [1, 2, 3, 4, 5]),
        ),
        *(
            ([*range(1, 9), 0, 0, 0, 0], False, range(1, 9)),
            ([1, 2, 3, 4, 5] + [0] * 9, False, [1, 2, 3, 4, 5, 0, 0, 0]),
        ),
        *(([0.1, 0, 0, 0, 0], True, [0.1, 0, 0, 0]), ([1, 2, 3], True, [1, 2, 3, 0])),
    ],
)
def test_distortion_is_padded_and_cut_knowingly(given_, fisheye, kept):
    text = (
        SECTION.format(section="a").replace("[0.1, -0.2, 0.0, 0.0]", json.dumps(given_))
        + f"fisheye = {json.dumps(fisheye)}\n"
    )
    np.testing.assert_array_equal(parse_cameras(text, "t")[0].distortion, kept)


@pytest.mark.parametrize(
    ("height", "size"), [(480.0, "[640.0, 480.0]"), (2000.0, "[640.0, 2000.0]")]
)
def test_a_skew_is_dropped_only_where_nobody_sees_it(height, size):
    """It moves x by skew (y - cy) / fy, most at the farther edge: fy 501, cy 240 here."""
    seen = 0.05 * 501 / (height - 240)
    text = SECTION.format(section="a").replace("[640.0, 480.0]", size)
    assert (
        parse_cameras(text.replace("[[500.0, 0.0", f"[[500.0, {-0.99 * seen}"), "t")[0].matrix[0, 1]
        == 0
    )
    with pytest.raises(
        FormatError, match=r"without skew, found skew .*moves pixels by up to 0\.05"
    ):
        parse_cameras(text.replace("[[500.0, 0.0", f"[[500.0, {1.01 * seen}"), "t")


# --- bad files


def edited(old, new):
    text = POSED.format(section="a", angle=0.5)
    assert old in text
    return text.replace(old, new)


OURS = format_cameras_yaml(make_rig(), {})
BROKEN = {
    "empty": "",
    "words": "hello",
    "json": '{"cam": 1}',
    "list": "- 1\n- 2\n",
    "no camera": "[metadata]\nunit = 'm'\n",
    "toml cut": edited("translation = [1.0, 2.0, 3.0]", "translation = [1.0, 2."),
    "two names": POSED.format(section="a", angle=0)
    + POSED.format(section="b", angle=0)
    + "name = 'a'\n",
    "matrix 2 x 3": edited(", [0.0, 0.0, 1.0]]", "]"),
    "matrix ragged": edited("[0.0, 0.0, 1.0]]", "[0.0, 1.0]]"),
    "matrix of text": edited("[[500.0", "[['wide'"),
    "matrix transposed": edited(
        "[[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]",
        "[[500.0, 0.0, 0.0], [0.0, 501.0, 0.0], [320.0, 240.0, 1.0]]",
    ),
    "matrix with NaN": edited("500.0", "nan"),
    "negative focal length": edited("500.0", "-500.0"),
    "skew": edited("[[500.0, 0.0", "[[500.0, 9.0"),
    "skew of a fisheye": edited("[[500.0, 0.0", "[[500.0, 9.0").replace(
        "[0.1, -0.2, 0.0, 0.0]", "[0.1, -0.2, 0.0, 0.0]\nfisheye = true"
    ),
    "thin prism": edited("[0.1, -0.2, 0.0, 0.0]", "[1, 2, 3, 4, 5, 6, 7, 8, 0, 0.1, 0, 0]"),
    "tilt": edited("[0.1, -0.2, 0.0, 0.0]", "[1, 2, 3, 4, 5, 0, 0, 0, 0, 0, 0, 0, 0, 0.1]"),
    "3 coefficients": edited("[0.1, -0.2, 0.0, 0.0]", "[0.1, 0.2, 0.3]"),
    "6 coefficients": edited("[0.1, -0.2, 0.0, 0.0]", "[1, 2, 3, 4, 5, 6]"),
    "5 fisheye coefficients": edited("[0.1, -0.2, 0.0, 0.0]", "[1, 2, 3, 4, 5]\nfisheye = true"),
    "infinite coefficient": edited("[0.1, -0.2", "[inf, -0.2"),
    "size of three": edited("[640.0, 480.0]", "[640.0, 480.0, 3]"),
    "size of parts": edited("[640.0, 480.0]", "[640.5, 480.0]"),
    "size negative": edited("[640.0, 480.0]", "[-640, 480]"),
    "translation of two": edited("[1.0, 2.0, 3.0]", "[1.0, 2.0]"),
    "rotation of two": edited("[0.0, 0.0, 0.5]", "[0.0, 0.5]"),
    "rotation infinite": edited("[0.0, 0.0, 0.5]", "[0.0, 0.0, inf]"),
    "rotation enormous": edited("[0.0, 0.0, 0.5]", "[0.0, 0.0, 1e300]"),
    "a mirror": edited("[0.0, 0.0, 0.5]", "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]"),
    "a stretch": edited("[0.0, 0.0, 0.5]", "[[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]"),
    "opencv without a matrix": "%YAML:1.0\n---\nimage_width: 4\n",
    "opencv with one cut": opencv()[:-30],
    "opencv of another shape": opencv().replace("rows: 3", "rows: 2", 1),
    "opencv stereo": opencv("M1", extra="M2: 1\n"),
    "opencv with a foreign tag": opencv(extra="x: !!python/object:os.system {}\n"),
    "opencv with half a size": (
        "%YAML:1.0\n---\nK: [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]\n"
        "image_width: wide\nimage_height: 3\n"
    ),
    "yaml nested": "%YAML 1.2\n---\n" + "[" * 2_000,
    "yaml with an impossible date": opencv(extra="calibration_time: 2024-99-99\n"),
    "ours newer": OURS.replace("version: 1", "version: 2"),
    "ours empty": OURS[: OURS.index("cameras:\n")] + "cameras: []\n",
    "ours of text": OURS[: OURS.index("cameras:\n")] + "cameras: [a, b]\n",
    "ours of another model": OURS.replace("model: opencv", "model: division"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_bad_file_is_refused_in_one_line(name):
    with pytest.raises(FormatError) as caught:
        parse_rig(BROKEN[name], "somewhere/rig")
    message = str(caught.value)
    assert message.startswith("somewhere/rig")
    assert "\n" not in message
    assert "expected" in message
    assert "found" in message


def test_focal_lengths_that_are_not_positive_are_said():
    with pytest.raises(FormatError, match=r"positive focal lengths, found \[-500.0, 501.0\]"):
        parse_rig(BROKEN["negative focal length"], "somewhere/rig")


def test_missing_empty_and_binary_files_are_refused(tmp_path):
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    (tmp_path / "folder").mkdir()
    for name in ("binary", "folder", "nothing"):
        with pytest.raises(FormatError, match=name):
            read_cameras(tmp_path / name)


def test_a_rounded_rotation_is_made_a_rotation():
    matrix = matrix_from_vector(np.array([0.3, -0.2, 0.5]))
    rotation = parse_rig(edited("[0.0, 0.0, 0.5]", str(matrix.round(4).tolist())), "t").rotation[0]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rotation, matrix, atol=1e-4)
