"""Formats of 3D poses: what is written comes back, real files load with the right counts, bad ones
are refused in a line.
"""

import io
import itertools
from dataclasses import replace
from pathlib import Path

import c3d
import h5netcdf
import h5py
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mocap_calib.errors import FormatError, MismatchError, MocapCalibError
from mocap_calib.io.poses.axes import UP_AXES, turn_up_axis
from mocap_calib.io.poses.common import PoseFile, bare_poses
from mocap_calib.io.poses.formats import POSE_FORMATS
from mocap_calib.io.poses.read import join_individuals, load_poses, parse_poses, read_poses
from mocap_calib.io.poses.write import format_poses, write_poses
from mocap_calib.io.registry import find_format
from mocap_calib.results import Poses3D

SAMPLES = Path(__file__).parents[3] / "shared" / "formats" / "samples"
READ = [each for each in POSE_FORMATS if not each.only_written]
HERE = [each.name for each in READ if each.name != "nwb-3d"]
NAMES = st.text("abcXYZ019_.- ", min_size=1, max_size=8).filter(lambda name: name == name.strip())
QUALITY = {
    "poses-h5",
    "npz",
    "anipose-csv",
    "movement-3d",
}  # formats that carry errors, views and confidences
COVARIANCE = {"poses-h5", "npz"}  # and those that carry covariances too
UNIT = {"c3d": "mm", "anipose-csv": "arbitrary"}


@st.composite
def pose_files(draw, individuals=3, gaps=True, named=True):
    """Up to 3 individuals, 4 keypoints, 6 frames; a third of the points missing; some frames
    skipped.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    keypoints = tuple(draw(st.lists(NAMES, min_size=1, max_size=4, unique=True)))
    count = draw(st.integers(1, individuals))
    frames = np.unique(rng.integers(0, 40 if gaps else 1, size=6)) + draw(
        st.sampled_from([0, 1, 42150])
    )
    positions = rng.normal(size=(len(frames), count, len(keypoints), 3)) * 10.0 ** rng.integers(
        -2, 4
    )
    missing = rng.random(positions.shape[:3]) < 0.3
    positions[missing] = np.nan
    error, confidence = (np.where(missing, np.nan, rng.random(missing.shape)) for _ in range(2))
    views = np.where(missing, 0, rng.integers(2, 6, missing.shape))
    names = (
        tuple(draw(st.lists(NAMES, min_size=count, max_size=count, unique=True))) if named else ()
    )
    rate = draw(st.sampled_from([30.0, 29.97, 100.0, 1 / 3]))
    return PoseFile(
        Poses3D(
            keypoints,
            frames,
            positions,
            error,
            views,
            confidence,
            draw(st.sampled_from(["m", "mm"])),
            np.where(missing[..., None], np.nan, rng.random((*missing.shape, 6), np.float32)),
        ),
        rate,
        names,
        edges=tuple((k - 1, k) for k in range(1, len(keypoints))),
    )


def dense(file):
    """On all frames from the first that has something to the last, as `assert_poses` compares."""
    seen = np.isfinite(file.poses.positions).any((1, 2, 3))
    return file.poses.frames[seen], file.poses.positions[seen]


def assert_poses(file, back, name):
    assert back.poses.keypoints == file.poses.keypoints
    assert back.poses.unit == UNIT.get(name, file.poses.unit)
    scale = 1000.0 if name == "c3d" and file.poses.unit == "m" else 1.0
    for (frames, positions), (before, expected) in [(dense(back), dense(file))]:
        np.testing.assert_array_equal(frames, before)
        np.testing.assert_allclose(
            positions, expected * scale, rtol=2e-7 if name == "c3d" else 0, atol=0
        )  # float32
    if name in QUALITY:
        for field in ("error", "views", "confidence"):
            np.testing.assert_array_equal(getattr(back.poses, field), getattr(file.poses, field))
    if name in COVARIANCE:
        np.testing.assert_array_equal(back.poses.covariance, file.poses.covariance)
    else:
        assert np.isnan(back.poses.covariance).all()


@pytest.mark.parametrize("name", HERE)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_what_is_written_comes_back(name, data):
    single = find_format(POSE_FORMATS, name).single
    file = data.draw(pose_files(individuals=1 if single else 3))
    assume(any(np.isfinite(file.poses.positions).ravel()))
    written = format_poses(file, name, Path("x"))
    files, lost = written.files, written.lost
    back = parse_poses(files["x"], "x")
    assert_poses(file, back, name)
    if not single:
        assert back.individuals == file.individuals
    if name == "poses-h5":
        assert back.edges == file.edges
    if name != "anipose-csv":
        assert back.rate == pytest.approx(file.rate, rel=1e-7)  # c3d has a float32
    for what in lost:
        assert "\n" not in what
    assert (name in COVARIANCE) == ("covariances" not in lost)
    assert (name in QUALITY) == (
        not any("errors" in what for what in lost) or not np.isfinite(file.poses.error).any()
    )


@pytest.mark.parametrize("name", HERE)
def test_the_same_poses_are_the_same_bytes(name):
    file = example()
    assert format_poses(file, name, Path("x")) == format_poses(file, name, Path("x"))


def example(individuals=2, keypoints=("nose", "tail")):
    rng = np.random.default_rng(1)
    positions = rng.normal(size=(5, individuals, len(keypoints), 3))
    positions[1, 0, 0] = np.nan
    quality = np.where(np.isfinite(positions[..., 0]), 0.5, np.nan)
    poses = Poses3D(
        keypoints,
        np.array([3, 4, 5, 7, 8]),
        positions,
        quality,
        np.where(np.isfinite(quality), 3, 0),
        quality,
        "m",
        rng.random((5, individuals, len(keypoints), 6), np.float32),
    )
    return PoseFile(poses, 60.0)


def test_formats_of_one_individual_write_a_file_each(tmp_path):
    file = example()
    lost = write_poses(tmp_path / "p.trc", file, "trc")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p_0.trc", "p_1.trc"]
    assert "reprojection errors" in lost
    back = join_individuals(
        [load_poses(tmp_path / "p_0.trc"), load_poses(tmp_path / "p_1.trc")], "there"
    )
    assert_poses(file, back, "trc")


def test_of_joined_files_nothing_is_said_where_one_has_no_frame():
    first = example(1)
    kept = Poses3D(
        first.poses.keypoints,
        first.poses.frames[1:] + 2,
        *(getattr(first.poses, name)[1:] for name in ("positions", "error", "views")),
        first.poses.confidence[1:],
        "m",
    )
    joined = join_individuals([first, replace(first, poses=kept)], "there").poses
    absent = ~np.isin(joined.frames, kept.frames)
    assert absent.any()
    assert np.isnan(joined.positions[absent, 1]).all()
    assert (joined.views[absent, 1] == 0).all()
    assert (joined.source[absent, 1] == 0).all()


@pytest.mark.parametrize(
    ("given_", "kept"),
    [
        ((("anna",), ("bert",)), ("anna", "bert")),
        ((("anna",), ("individual_0",)), ("anna", "individual_1")),
        (((), ()), ("individual_0", "individual_1")),
        ((("anna",), ("anna",)), ("individual_0", "individual_1")),
    ],
)
def test_joined_files_keep_the_names_that_tell_individuals_apart(given_, kept):
    assert (
        join_individuals(
            [replace(example(1), individuals=names) for names in given_], "there"
        ).individuals
        == kept
    )


@pytest.mark.parametrize("said_by", ["numbers", "references", "both"])
@pytest.mark.parametrize("order", list(itertools.permutations(range(4))), ids=str)
def test_movement_s_dimensions_come_in_any_order(order, said_by, tmp_path):
    """xarray writes what it is given; three of each, so that no shape tells an order. netCDF-C
    writes no numbers, old h5netcdf no references.
    """
    names = ("time", "space", "keypoints", "individuals")  # as before movement 0.17
    labels = {
        "space": ("x", "y", "z"),
        "keypoints": ("a", "b", "c"),
        "individuals": ("i", "j", "k"),
    }
    positions, confidence = (
        np.random.default_rng(0).normal(size=(3, 3, 3, 3)),
        np.random.default_rng(1).random((3, 3, 3)),
    )
    with h5netcdf.File(tmp_path / "old.nc", "w") as file:
        file.dimensions = dict.fromkeys((names[k] for k in order), 3)
        file.create_variable(
            "frame", ("time",), data=np.arange(3)
        )  # a variable that is no dimension
        file.create_variable("time", ("time",), data=np.arange(3))
        for name, texts in labels.items():
            file.create_variable(
                name, (name,), data=np.array(texts, dtype=object), dtype=h5py.string_dtype()
            )
        file.create_variable(
            "position",
            tuple(names[k] for k in order),
            data=positions.transpose(0, 3, 2, 1).transpose(order),
        )
        bare = [k for k in order if names[k] != "space"]
        file.create_variable(
            "confidence",
            tuple(names[k] for k in bare),
            data=confidence.transpose([(0, -1, 2, 1)[k] for k in bare]),
        )
    with h5py.File(tmp_path / "old.nc", "a") as file:
        gone = {"numbers": "DIMENSION_LIST", "references": "_Netcdf4Coordinates"}.get(said_by)
        for variable in (file["position"], file["confidence"]) if gone else ():
            del variable.attrs[gone]
    back = load_poses(tmp_path / "old.nc")
    assert (back.poses.keypoints, back.individuals) == (labels["keypoints"], labels["individuals"])
    np.testing.assert_array_equal(back.poses.positions, positions)
    np.testing.assert_array_equal(back.poses.confidence, confidence)


def test_movement_s_dimensions_are_as_long_as_their_coordinates(tmp_path):
    """Nothing says which is which: the present order is assumed, and refused where the lengths
    contradict it.
    """
    write_poses(tmp_path / "p.nc", example(2), "movement-3d")
    with h5py.File(tmp_path / "p.nc", "a") as file:
        np.testing.assert_allclose(file["time"], example(2).poses.frames / 60.0)  # seconds
        turned_round = file["position"][:].transpose(0, 3, 2, 1)
        del file["position"]
        file["position"] = turned_round
    with pytest.raises(FormatError, match="over time, space, keypoint, individual"):
        load_poses(tmp_path / "p.nc")


def test_movement_s_own_times_are_frames_of_its_rate(tmp_path):
    """The variable `frame` is ours; times half a frame off are no frames."""
    write_poses(tmp_path / "p.nc", example(2), "movement-3d")
    with h5py.File(tmp_path / "p.nc", "a") as file:
        del file["frame"]
    np.testing.assert_array_equal(load_poses(tmp_path / "p.nc").poses.frames, [3, 4, 5, 7, 8])
    with h5py.File(tmp_path / "p.nc", "a") as file:
        file["time"][0] += 0.5 / 60.0
    said = r"p\.nc: expected a 3D data set of movement, found .* fps.*; save it again"
    with pytest.raises(FormatError, match=said):
        load_poses(tmp_path / "p.nc")


def test_a_unit_is_given_to_poses_that_have_none_but_not_to_our_own(tmp_path):
    """Ours say that their lengths were never scaled, which no unit mends."""
    bare = replace(example(1), poses=replace(example(1).poses, unit="arbitrary"))
    for name, own in (("bare", bare), ("metres", example(1))):
        for kind in ("movement-3d", "poses-h5"):
            write_poses(tmp_path / f"{name}.{kind}", own, kind)
    assert load_poses(tmp_path / "bare.movement-3d", unit="mm").poses.unit == "mm"
    with pytest.raises(MismatchError, match="set the scale by a known length"):
        load_poses(tmp_path / "bare.poses-h5", unit="mm")
    for kind in ("movement-3d", "poses-h5"):
        assert load_poses(tmp_path / f"metres.{kind}", unit="m").poses.unit == "m"
        with pytest.raises(MismatchError, match="expected lengths in m"):
            load_poses(tmp_path / f"metres.{kind}", unit="mm")


def test_a_damaged_file_of_our_own_is_named(tmp_path):
    write_poses(tmp_path / "p.h5", example(2), "poses-h5")
    with h5py.File(tmp_path / "p.h5", "a") as file:
        file["edges"] = np.arange(3)
    with pytest.raises(FormatError, match=r"^\S*p\.h5: expected "):
        load_poses(tmp_path / "p.h5", "poses-h5")


def test_a_file_where_a_folder_is_is_refused_by_its_name(tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(IsADirectoryError) as caught:
        write_poses(tmp_path / "there", example(), "npz")
    assert caught.value.filename == str(tmp_path / "there")
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_a_row_of_a_trc_that_has_a_number_more_is_refused(tmp_path):
    write_poses(tmp_path / "p.trc", example(1), "trc")
    lines = (tmp_path / "p.trc").read_text().splitlines()
    cells = 2 + 3 * len(example().poses.keypoints)
    lines[-1] = "\t".join([*lines[-1].split("\t")[:cells], "0.5"])
    (tmp_path / "p.trc").write_text("\n".join(lines))
    said = f"line {len(lines)}: expected {cells} cells, found {cells + 1}"
    with pytest.raises(FormatError, match=said):
        load_poses(tmp_path / "p.trc")


def test_a_trc_is_what_opensim_reads(tmp_path):
    write_poses(tmp_path / "p.trc", example(1), "trc")
    lines = (tmp_path / "p.trc").read_text().splitlines()
    assert lines[0] == "PathFileType\t4\t(X/Y/Z)\tp.trc"
    assert len(lines[1].split("\t")) == 8
    assert lines[2].split("\t") == ["60.0", "60.0", "6", "2", "m", "60.0", "3", "6"]
    assert lines[3].rstrip("\t").split("\t") == ["Frame#", "Time", "nose", "", "", "tail"]
    assert lines[4].strip("\t").split("\t") == ["X1", "Y1", "Z1", "X2", "Y2", "Z2"]
    second = lines[6].split("\t")
    assert second[:5] == ["4", repr(4 / 60), "", "", ""]
    assert "nan" not in "".join(lines[5:])
    write_poses(tmp_path / "q.trc", example(1, ("nose",)), "trc")
    # OpenSim 4.6 counts an empty last cell only where a tab follows it
    assert (tmp_path / "q.trc").read_text().splitlines()[6] == "4\t" + repr(4 / 60) + "\t" * 4
    assert [line.split("\t")[0] for line in lines[5:]] == ["3", "4", "5", "6", "7", "8"]


@pytest.mark.slow
def test_a_long_c3d_keeps_all_its_frames(tmp_path):
    """More than a 16-bit header counts: the writer that does not say so is the trap."""
    frames = np.arange(66_000)
    positions = np.zeros((len(frames), 1, 1, 3)) + frames[:, None, None, None]
    nothing = np.full(positions.shape[:3], np.nan)
    file = PoseFile(
        Poses3D(
            ("a",),
            frames,
            positions,
            nothing,
            np.zeros(nothing.shape, dtype=np.int64),
            nothing,
            "mm",
        ),
        100.0,
    )
    write_poses(tmp_path / "long.c3d", file, "c3d")
    back = load_poses(tmp_path / "long.c3d")
    np.testing.assert_array_equal(back.poses.frames, frames)
    np.testing.assert_array_equal(back.poses.positions, positions)
    with open(tmp_path / "long.c3d", "rb") as handle, pytest.warns(UserWarning, match="analog"):
        assert c3d.Reader(handle).frame_count == len(frames)


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("trc", {"rate": float("nan")}, "fps="),
        ("c3d", {"rate": float("nan")}, "fps="),
        ("c3d", {"poses": replace(example().poses, unit="arbitrary")}, "mocap-calib scale"),
        ("trc", {"poses": replace(example().poses, unit="arbitrary")}, "mocap-calib scale"),
        (
            "c3d",
            {"poses": replace(example().poses, frames=np.array([-3, 4, 5, 7, 8]))},
            "frames from 0",
        ),
        ("c3d", {"poses": replace(example().poses, keypoints=("nose", "a:b"))}, "without a colon"),
        ("trc", {"poses": replace(example().poses, keypoints=("nose", "a\tb"))}, "without tabs"),
        (
            "trc",
            {"poses": replace(example().poses, frames=np.array([3, 4, 5, 7, 10**12]))},
            "no gaps",
        ),
    ],
)
def test_what_cannot_be_carried_is_refused_in_a_line(name, change, reason):
    with pytest.raises(MismatchError, match=reason):
        format_poses(replace(example(), **change), name, Path("x"))


def test_too_many_markers_for_c3d_are_refused():
    with pytest.raises(MismatchError, match="256"):
        format_poses(example(2, tuple(f"k{i}" for i in range(128))), "c3d", Path("x"))


def test_nwb_says_what_is_missing_or_comes_back():
    try:
        import ndx_pose  # noqa: F401
    except ImportError:
        with pytest.raises(MismatchError, match=r"mocap-calib\[nwb\]"):
            format_poses(example(), "nwb-3d", Path("x"))
        return
    files = format_poses(example(), "nwb-3d", Path("x")).files
    back = parse_poses(files["x"], "x")
    assert_poses(example(), back, "nwb-3d")
    np.testing.assert_array_equal(back.poses.confidence, example().poses.confidence)
    assert (back.individuals, back.rate) == (example().individuals, 60.0)


def test_nwb_is_read_without_its_packages():
    """Two keypoints in three dimensions, in millimetres; of one there is also a series of two."""
    content = io.BytesIO()
    position = np.random.default_rng(0).normal(size=(2, 5, 3))
    with h5py.File(content, "w") as file:
        for name, values in (("nose", position[0]), ("tail", position[1]), ("2D", np.ones((5, 2)))):
            series = file.create_group(f"processing/behavior/mouse/{name}")
            series.attrs["neurodata_type"] = "PoseEstimationSeries"
            series["data"] = values
            series["data"].attrs["conversion"] = 1000.0
            series["data"].attrs["unit"] = "millimeters"
            series["starting_time"] = 0.1
            series["starting_time"].attrs["rate"] = 30.0
    back = parse_poses(content.getvalue(), "x")
    assert (back.individuals, back.rate) == (("mouse",), 30.0)
    assert (back.poses.keypoints, back.poses.unit) == (("nose", "tail"), "mm")
    assert back.poses.frames.tolist() == [3, 4, 5, 6, 7]
    np.testing.assert_allclose(back.poses.positions[:, 0], 1000 * position.swapaxes(0, 1))


@pytest.mark.parametrize("up", UP_AXES)
def test_what_was_up_is_y(up):
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    file = example()
    file = replace(
        file, poses=replace(file.poses, positions=np.broadcast_to(axis, file.poses.positions.shape))
    )
    np.testing.assert_array_equal(turn_up_axis(file, up).poses.positions[0, 0, 0], [0, 1, 0])
    basis = PoseFile(bare_poses(("a",), np.arange(3), np.eye(3)[:, None, None], unit="m"))
    assert np.linalg.det(turn_up_axis(basis, up).poses.positions[:, 0, 0]) == pytest.approx(1.0)


# --- what other programs wrote

REAL = {
    "trc/S00_P00_T01_BalancingTrial_0-100.trc": ("trc", 100, 1, 21, "m", 60.0),
    "trc/S00_P00_T01_BalancingTrial_0-100_filt_butterworth.trc": ("trc", 100, 1, 21, "m", 60.0),
    "trc/S00_P00_T00_StaticTrial_0-12_filt_butterworth_LSTM.trc": ("trc", 12, 1, 64, "m", 60.0),
    "trc/S00_P01_T02_Participants1-2_P1_0-100.trc": ("trc", 100, 1, 21, "m", 60.0),
    "anipose_csv/points3d_anipose_layout.csv": ("anipose-csv", 120, 1, 15, "arbitrary", None),
    "sleap_anipose_session/points3d.h5": ("sleap-anipose", 120, 1, 15, "arbitrary", None),
    "movement_netcdf/reaching3d_50frames.nc": ("movement-3d", 50, 1, 33, "arbitrary", 30.0),
    "movement_netcdf/h5netcdf_written_3d.nc": ("movement-3d", 20, 1, 3, "arbitrary", 60.0),
    "ndx_pose_nwb/generated_3d_ndx0.4.nwb": ("nwb-3d", 20, 1, 2, "mm", 60.0),
    "generated_out/c3dlib_50.c3d": ("c3d", 50, 1, 4, "mm", 60.0),
    "generated_out/ezc3d_50.c3d": ("c3d", 50, 1, 4, "mm", 60.0),
}
REFUSED = (
    "movement_netcdf/sleap_back_2d.nc",
    "ndx_pose_nwb/0.3.0_poseestimation_two_cameras.nwb",
    "sleap_analysis_h5/predictions.analysis.h5",
    "dlc_3d_h5/reachingDEMO_3D.h5",
)
needs_samples = pytest.mark.skipif(not SAMPLES.is_dir(), reason="the sample files are not here")


@needs_samples
@pytest.mark.parametrize("path", REAL)
def test_real_files_load(path):
    name, frames, individuals, keypoints, unit, rate = REAL[path]
    content = (SAMPLES / path).read_bytes()
    assert [each.name for each in POSE_FORMATS if each.sniff(content)] == [name]
    file = parse_poses(content, path)
    assert file.poses.positions.shape == (frames, individuals, keypoints, 3)
    assert file.poses.unit == unit
    assert rate is None or file.rate == rate
    assert np.isfinite(file.poses.positions).any()


@needs_samples
@pytest.mark.parametrize("path", REFUSED)
def test_files_without_3d_poses_are_refused(path):
    with pytest.raises(FormatError, match="one of: poses-h5"):
        load_poses(SAMPLES / path)


@needs_samples
def test_two_formats_of_one_real_session_agree():
    """The CSV was made of the h5, with 3 digits less than a double has: 1e-9 of 600 mm."""
    csv, h5 = (
        read_poses(SAMPLES / path)
        for path in ("anipose_csv/points3d_anipose_layout.csv", "sleap_anipose_session/points3d.h5")
    )
    np.testing.assert_allclose(csv.positions, h5.positions, rtol=0, atol=6e-7)


# --- damage


@pytest.mark.parametrize("name", [each.name for each in READ])
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"hello",
        b"\x89HDF\r\n\x1a\n",
        b"PK\x03\x04",
        b"PathFileType\n",
        b"\x02\x50" + bytes(600),
    ],
)
def test_a_format_that_is_named_refuses_what_is_not_it(name, content):
    with pytest.raises(MocapCalibError) as caught:
        parse_poses(content, "somewhere", name)
    assert "expected" in str(caught.value)


def test_an_npz_with_pickles_is_refused(tmp_path):
    np.savez(tmp_path / "p.npz", positions=np.array([{}], dtype=object))
    with pytest.raises(FormatError, match="npz of poses"):
        load_poses(tmp_path / "p.npz")


def test_an_h5_of_something_else_is_refused(tmp_path):
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["tracks"] = np.zeros((3, 2))
    with pytest.raises(FormatError, match="one of"):
        load_poses(tmp_path / "x.h5")


def test_covariances_go_with_the_unit_the_axes_and_the_individual(tmp_path):
    """Turned with the points, and joined in the order of the files."""
    file = example()
    entries = file.poses.covariance
    for up in UP_AXES:
        turned = turn_up_axis(file, up).poses
        np.testing.assert_allclose(turned.sigma, file.poses.sigma, rtol=1e-6)
        for k in range(2):  # a variance along an axis is that along the axis it becomes
            axis = np.zeros((1, 1, 1, 3))
            axis[..., k] = 1
            along = replace(file.poses, positions=np.broadcast_to(axis, file.poses.positions.shape))
            to = np.abs(turn_up_axis(replace(file, poses=along), up).poses.positions[0, 0, 0])
            found = turned.covariance[..., [0, 3, 5]][..., to.argmax()]
            np.testing.assert_allclose(found, entries[..., [0, 3][k]], rtol=1e-6)
    for k in range(2):
        one = file.poses.select([k])
        write_poses(tmp_path / f"{k}.npz", PoseFile(one, 60.0), "npz")
    back = join_individuals([load_poses(tmp_path / f"{k}.npz") for k in range(2)], "there")
    np.testing.assert_array_equal(back.poses.covariance, entries)


def test_formats_without_a_unit_say_which_is_lost():
    poses = bare_poses(("left_hip", "left_knee"), np.arange(3), np.ones((3, 1, 2, 3)), unit="m")
    for file, lost in (
        (PoseFile(poses, 30.0), ("the unit (m)",)),
        (PoseFile(replace(poses, unit="arbitrary"), 30.0), ()),
    ):
        for name in ("bvh", "anipose-csv"):
            assert format_poses(file, name, Path("x")).lost == lost
