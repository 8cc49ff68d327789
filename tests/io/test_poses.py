"""The laws of formats of 3D poses, over the table in `conformance.POSES`, and their details.

What is written comes back; other programs read it; axes, units, names and covariances go along.
"""

import itertools
import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import c3d
import h5netcdf
import h5py
import numpy as np
import pytest
import xarray
from conformance import CORPUS, POSES
from golden.command import call
from golden.damage import change_store
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import mocap_calib as mc
from mocap_calib.types import World

NAMES = st.text("abcXYZ019_.- ", min_size=1, max_size=8).filter(lambda name: name == name.strip())


@st.composite
def made_poses(draw, most=3):
    """Up to 3 individuals, 4 keypoints, 6 frames; a third of the points missing; skipped frames."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    keypoints = tuple(draw(st.lists(NAMES, min_size=1, max_size=4, unique=True)))
    count = draw(st.integers(1, most))
    frames = np.unique(rng.integers(0, 40, 6)) + draw(st.sampled_from([0, 1, 42150]))
    shape = (len(frames), count, len(keypoints))
    positions = rng.normal(size=(*shape, 3)) * 10.0 ** rng.integers(-2, 4)
    missing = rng.random(shape) < 0.3
    positions[missing] = np.nan
    assume(np.isfinite(positions).any())
    error, confidence = (np.where(missing, np.nan, rng.random(shape)) for _ in range(2))
    views = np.where(missing, 0, rng.integers(2, 6, shape))
    covariance = np.where(missing[..., None], np.nan, rng.random((*shape, 6), np.float32))
    unit = draw(st.sampled_from(["m", "mm"]))
    poses = mc.Poses3D(keypoints, frames, positions, error, views, confidence, unit, covariance)
    names = draw(st.lists(NAMES, min_size=count, max_size=count, unique=True))
    return poses, draw(st.sampled_from([30.0, 29.97, 100.0, 1 / 3])), tuple(names)


def example(individuals=2, keypoints=("nose", "tail"), **changes) -> mc.Poses3D:
    rng = np.random.default_rng(1)
    shape = (5, individuals, len(keypoints))
    positions = rng.normal(size=(*shape, 3))
    positions[1, 0, 0] = np.nan
    quality = np.where(np.isfinite(positions[..., 0]), 0.5, np.nan)
    views, covariance = np.where(np.isfinite(quality), 3, 0), rng.random((*shape, 6), np.float32)
    frames = np.array([3, 4, 5, 7, 8])
    made = mc.Poses3D(keypoints, frames, positions, quality, views, quality, "m", covariance)
    return replace(made, **changes)


def bare(keypoints, positions, unit="m", frames=None, **changes) -> mc.Poses3D:
    """Return poses of which nothing else is known."""
    points = np.asarray(positions, dtype=float)
    nothing, frames = (
        np.full(points.shape[:3], np.nan),
        np.arange(len(points)) if frames is None else frames,
    )
    views = np.zeros(points.shape[:3], dtype=np.int64)
    return mc.Poses3D(keypoints, frames, points, nothing, views, nothing, unit, **changes)


def known_of(folder: Path, *sources: object) -> dict[str, Any]:
    """Return what files hold beside the poses: `convert` makes an archive for numpy of them."""
    done = call("convert", *sources, "known.npz", "--to", "npz", folder=folder)
    assert done.status == 0, done.stderr
    with np.load(folder / "known.npz") as archive:
        return dict(archive)


def seen(poses: mc.Poses3D) -> tuple[np.ndarray, np.ndarray]:
    """Return frames in which something is, and the positions there."""
    there = np.isfinite(poses.positions).any((1, 2, 3))
    return poses.frames[there], poses.positions[there]


@pytest.mark.parametrize("name", POSES)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_what_is_written_comes_back(name, data, tmp_path_factory):
    form, folder = POSES[name], tmp_path_factory.mktemp("poses")
    poses, rate, names = data.draw(made_poses(1 if form.single else 3))
    path = folder / f"x{form.ending}"
    for place in "ab":
        target = folder / place / path.name
        lost = mc.write(poses, target, name, fps=rate, individuals=names)
    assert (folder / "a" / path.name).read_bytes() == (folder / "b" / path.name).read_bytes()
    back = mc.read_poses(folder / "a" / path.name)
    assert (back.keypoints, back.unit) == (poses.keypoints, form.unit or poses.unit)
    frames, positions = seen(poses)
    scale = 1000.0 if name == "c3d" and poses.unit == "m" else 1.0
    np.testing.assert_array_equal(seen(back)[0], frames)
    tolerance = 2e-7 if name == "c3d" else 0  # float32
    np.testing.assert_allclose(seen(back)[1], positions * scale, rtol=tolerance, atol=0)
    if form.known:
        for field in ("error", "views", "confidence"):
            np.testing.assert_array_equal(getattr(back, field), getattr(poses, field))
    expected = poses.covariance if form.known == "all" else np.full_like(back.covariance, np.nan)
    np.testing.assert_array_equal(back.covariance, expected)
    assert ("covariances" in lost) == (form.known != "all")
    assert any("errors" in what for what in lost) == (not form.known)
    beside = known_of(folder, f"a/{path.name}")
    if form.rate:
        assert beside["fps"] == pytest.approx(rate, rel=1e-7)  # c3d has a float32
    if not form.single:
        assert beside["individuals"].tolist() == list(names)


def _by_c3d(path):
    with path.open("rb") as file, warnings.catch_warnings(action="ignore"):  # no analog data
        reader = c3d.Reader(file)
        frames = [(number, points) for number, points, _ in reader.read_frames(copy=True)]
    points = np.array([each for _, each in frames]).reshape(-1, 2, 2, 5)
    places = np.where(points[..., 3:4] >= 0, points[..., :3] / 1000, np.nan)
    return [number - 1 for number, _ in frames], places  # counted from 1


def _by_xarray(path):
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        np.testing.assert_allclose(data["time"], example().frames / 60.0)  # seconds
        order = ("time", "individual", "keypoint", "space")
        return data["frame"].to_numpy(), data["position"].transpose(*order).to_numpy()


OTHERS: dict[str, Callable] = {"c3d": _by_c3d, "movement-3d": _by_xarray}


@pytest.mark.parametrize("name", OTHERS)
def test_another_program_reads_what_is_written(name, tmp_path):
    poses, path = example(), tmp_path / "x"
    mc.write(poses, path, name, fps=60.0)
    frames, positions = OTHERS[name](path)
    rows = [np.asarray(frames).tolist().index(frame) for frame in poses.frames]
    np.testing.assert_allclose(positions[rows], poses.positions, rtol=2e-7)
    assert np.isnan(np.delete(positions, rows, axis=0)).all()


# --- several files, individuals and axes


def test_formats_of_one_individual_write_a_file_each(tmp_path):
    poses = example()
    lost = mc.write(poses, tmp_path / "p.trc", fps=60.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p_0.trc", "p_1.trc"]
    assert "reprojection errors" in lost
    back = known_of(tmp_path, "p_0.trc", "p_1.trc")
    rows = np.searchsorted(back["frames"], poses.frames)
    np.testing.assert_array_equal(back["positions"][rows], poses.positions)
    beside = call("convert", "known.npz", "p.trc", folder=tmp_path)
    assert beside.status == 0
    mc.write(example(3), tmp_path / "q.npz", fps=60.0)
    (tmp_path / "p_2.trc").write_text("a third")
    done = call("convert", "known.npz", "p.trc", folder=tmp_path)
    assert "p_2.trc: expected no file of a further individual" in done.stderr[-1]


@pytest.mark.parametrize(
    ("given_", "kept"),
    [
        ((("anna",), ("bert",)), ["anna", "bert"]),
        ((("anna",), ("individual_0",)), ["anna", "individual_1"]),
        (((), ()), ["individual_0", "individual_1"]),
        ((("anna",), ("anna",)), ["individual_0", "individual_1"]),
    ],
)
def test_joined_files_keep_what_is_known_of_each_individual(given_, kept, tmp_path):
    """Names that tell them apart; nothing of the frames that a file does not have."""
    first = example(1)
    later = first.select([0])
    later = mc.Poses3D(
        *(first.keypoints, first.frames[1:] + 2),
        *(getattr(first, name)[1:] for name in ("positions", "error", "views", "confidence")),
        *("m", first.covariance[1:]),
    )
    for k, (poses, names) in enumerate(zip((first, later), given_, strict=True)):
        mc.write(poses, tmp_path / f"{k}.npz", fps=60.0, individuals=names)
    found = known_of(tmp_path, "0.npz", "1.npz")
    assert found["individuals"].tolist() == kept
    for k, poses in enumerate((first, later)):
        rows = np.searchsorted(found["frames"], poses.frames)
        for name in ("positions", "covariance"):
            np.testing.assert_array_equal(found[name][rows, k], getattr(poses, name)[:, 0])
    absent = ~np.isin(found["frames"], later.frames)
    assert absent.any()
    assert np.isnan(found["positions"][absent, 1]).all()
    assert not found["views"][absent, 1].any()
    assert not found["source"][absent, 1].any()
    done = call("convert", "0.npz", "1.npz", "p.trc", "--fps", "30", folder=tmp_path)
    assert "60 frames per second, as the file says" in done.stderr[-1]
    mc.write(example(1, ("nose", "ear")), tmp_path / "2.npz", fps=60.0)
    done = call("convert", "0.npz", "2.npz", "x.npz", folder=tmp_path)
    assert "expected files of one recording" in done.stderr[-1]


AXES = ("x", "y", "z", "-x", "-y", "-z")


@pytest.mark.parametrize("up", AXES)
def test_what_was_up_is_y(up, tmp_path):
    """A turn: right hands stay right hands, and covariances turn with the points."""
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    basis = np.concatenate([axis[None], np.eye(3), np.zeros((1, 3))])[:, None, None]
    entries = np.tile(np.float32([1, 0.1, 0.2, 2, 0.3, 3]), (5, 1, 1, 1))
    mc.write(bare(("a",), basis, covariance=entries), tmp_path / "a.npz")
    assert call("convert", "a.npz", "b.npz", "--up", up, folder=tmp_path).status == 0
    back = mc.read_poses(tmp_path / "b.npz")
    turn = back.positions[1:4, 0, 0].T
    np.testing.assert_array_equal(back.positions[0, 0, 0], [0, 1, 0])
    assert np.linalg.det(turn) == pytest.approx(1.0)
    full = np.array([[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 3]])
    expected = (turn @ full @ turn.T)[np.triu_indices(3)]
    np.testing.assert_allclose(back.covariance[0, 0, 0], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("seed", "name", "axis"), [(0, "c3d", 2), *((seed, "trc", 1) for seed in range(4))]
)
def test_what_is_known_to_be_up_becomes_the_axis_of_the_format(seed, name, axis, tmp_path):
    """Heights above the floor along it; c3d keeps z where z is up, and says so."""
    rng = np.random.default_rng(seed)
    up = rng.normal(size=3) if seed else np.array([0.0, 0, 1])
    world = World("floor", up=up / np.linalg.norm(up), floor=np.zeros(3))
    poses = example(1, world=world)
    mc.write(poses, tmp_path / f"x.{name}", fps=60.0)
    back = mc.read_poses(tmp_path / f"x.{name}")
    heights = seen(poses)[1] @ world.up * (1000 if name == "c3d" else 1)
    np.testing.assert_allclose(seen(back)[1][..., axis], heights, rtol=2e-6, atol=1e-6)
    if name == "trc" and not seed:
        np.testing.assert_array_equal(seen(back)[1], seen(poses)[1][..., [1, 2, 0]])
    if name == "c3d":
        with (tmp_path / "x.c3d").open("rb") as file, warnings.catch_warnings(action="ignore"):
            assert c3d.Reader(file).get("POINT:Y_SCREEN").string_value == "+Z"


@pytest.mark.parametrize(
    ("given_", "markers"),
    [
        (("pelvis", "l_knee", "LeftBigToe", "watch"), ("Hip", "LKnee", "LBigToe", "watch")),
        (("left_hip", "LHip", "neck"), ("left_hip", "LHip", "neck")),  # else one twice
        (("withers", "tail_base", "left_elbow"), ("withers", "tail_base", "left_elbow")),
    ],
)
def test_markers_of_people_are_called_as_opensim_s(given_, markers, tmp_path):
    mc.write(bare(given_, np.ones((2, 1, len(given_), 3))), tmp_path / "x.trc", fps=30.0)
    assert mc.read_poses(tmp_path / "x.trc").keypoints == markers


# --- what cannot be carried, and units

TABBED, COLON = (example(1, ("nose", name)) for name in ("a\tb", "a:b"))
MANY = example(2, tuple(f"k{i}" for i in range(128)))
LATE, EARLY = (example(1, frames=np.array([k, 4, 5, 7, 10**12 if k == 3 else 8])) for k in (3, -3))


@pytest.mark.parametrize(
    ("name", "poses", "fps", "reason"),
    [
        *((name, example(1), None, "fps=") for name in ("trc", "c3d", "bvh")),
        *(
            (name, example(1, unit="arbitrary"), 60.0, "mocap-calib scale")
            for name in ("trc", "c3d")
        ),
        ("c3d", EARLY, 60.0, "frames from 0"),
        ("c3d", COLON, 60.0, "without a colon"),
        ("c3d", MANY, 60.0, "256"),
        ("trc", TABBED, 60.0, "without tabs"),
        ("trc", LATE, 60.0, "no gaps"),
        ("bvh", bare(("a", "b"), np.zeros((3, 1, 2, 3))), 30.0, "that a skeleton joins"),
    ],
)
def test_what_cannot_be_carried_is_refused_in_a_line(name, poses, fps, reason, tmp_path):
    with pytest.raises(mc.MismatchError, match=reason) as refused:
        mc.write(poses, tmp_path / "x", name, fps=fps)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_unit_is_given_to_poses_that_have_none_but_not_to_our_own(tmp_path):
    """Ours report lengths that were never scaled, which no unit corrects."""
    for kind in ("movement-3d", "poses-h5"):
        mc.write(example(1, unit="arbitrary"), tmp_path / f"bare.{kind}", kind)
        mc.write(example(1), tmp_path / f"metres.{kind}", kind)
        assert mc.read_poses(tmp_path / f"metres.{kind}", unit="m").unit == "m"
        with pytest.raises(mc.MismatchError, match="expected lengths in m"):
            mc.read_poses(tmp_path / f"metres.{kind}", unit="mm")
    assert mc.read_poses(tmp_path / "bare.movement-3d", unit="mm").unit == "mm"
    with pytest.raises(mc.MismatchError, match="set the scale by a known length"):
        mc.read_poses(tmp_path / "bare.poses-h5", unit="mm")


@pytest.mark.parametrize("unit", ["m", "arbitrary"])
@pytest.mark.parametrize("name", ["bvh", "anipose-csv"])
def test_formats_without_a_unit_report_which_is_lost(name, unit, tmp_path):
    poses = bare(("left_hip", "left_knee"), np.ones((3, 1, 2, 3)), unit)
    lost = mc.write(poses, tmp_path / "x", name, fps=30.0)
    assert any("unit" in what and "(m)" in what for what in lost) == (unit == "m")


@pytest.mark.parametrize("name", ["poses-h5", "npz"])
def test_triangulated_points_and_sources_come_back(name, tmp_path):
    made = example()
    better = replace(
        made,
        positions=made.positions + 0.5,
        raw=made.positions,
        source=np.where(np.isfinite(made.error), 2, 0).astype(np.int8),
    )
    for poses, own in ((better, True), (made, False)):
        mc.write(poses, tmp_path / "x", name)
        back = mc.read_poses(tmp_path / "x")
        assert back == poses
        assert (back.raw is not back.positions) == own, "no second copy of triangulated points"


@pytest.mark.parametrize(
    "shape", [(5, 2, 2), (1, 1, 2), (0, 2, 2), (4, 0, 2), (70_000, 3, 5)], ids=str
)
def test_stores_of_all_sizes_come_back_and_missing_points_take_little_room(shape, tmp_path):
    """Half of the points of the long one are missing."""
    rng = np.random.default_rng(0)
    points = np.where(rng.random((*shape[:2], 1, 1)) < 0.5, np.nan, rng.normal(size=(*shape, 3)))
    poses = bare(tuple(f"k{k}" for k in range(shape[2])), points)
    for name in ("a.h5", "b.h5"):
        mc.write(poses, tmp_path / name, "poses-h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    assert mc.read_poses(tmp_path / "a.h5") == poses
    if len(points) > 1000:
        assert (tmp_path / "a.h5").stat().st_size < 0.75 * points.nbytes
        with h5py.File(tmp_path / "a.h5") as file:
            np.testing.assert_array_equal(file["position"][...], points)


# --- details of stores


TIMES = example().frames / 60.0
NANOSECONDS = 1_700_000_000_000_000_000 + np.arange(5)  # a sum of six would not go into 64 bits
DETAILS = [
    ("poses-h5", {"frames": NANOSECONDS}, NANOSECONDS),
    ("poses-h5", {"frames": NANOSECONDS.astype(np.uint64)}, NANOSECONDS),
    (
        "poses-h5",
        {"frames": np.array([1, 2, 3, 4, 2**63], dtype=np.uint64)},
        "whole numbers in `frames",
    ),
    ("poses-h5", {"frames": np.arange(5) + 0.5}, "whole numbers in `frames"),
    ("poses-h5", {"frames": np.zeros(2, dtype=int)}, "mocap-calib poses"),
    ("poses-h5", {"views": None}, "a dataset `views`"),
    ("poses-h5", {"error": np.zeros((5, 2, 9))}, "mocap-calib poses"),
    ("poses-h5", {"position": np.zeros((5, 2, 2))}, "expected .*found"),
    ("poses-h5", {"edges": [[0, 2]]}, "got 0 to 2"),
    ("poses-h5", {"edges": [[-1, 0]]}, "got -1 to 0"),
    ("poses-h5", {"edges": [[0.5, 1]]}, "whole numbers"),
    ("poses-h5", {"edges": [0, 1]}, "edges: expected shape"),
    ("movement-3d", {"frame": None}, example().frames),
    (
        "movement-3d",
        {"frame": None, "time": TIMES + 0.5 / 60 * (np.arange(5) == 0)},
        "whole frames",
    ),
    ("movement-3d", {"position": np.zeros((5, 2, 2, 3))}, "over time, space, keypoint, individual"),
]


@pytest.mark.parametrize(("name", "changes", "expected"), DETAILS, ids=lambda each: str(each)[:40])
def test_a_detail_of_a_store_is_read_or_refused(name, changes, expected, tmp_path):
    path = tmp_path / "x"
    mc.write(example(), path, name, fps=60.0)
    change_store(path, changes)
    if not isinstance(expected, str):
        np.testing.assert_array_equal(mc.read_poses(path).frames, expected)
        return
    with pytest.raises(mc.FormatError, match=expected) as refused:
        mc.read_poses(path, name)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("said_by", ["numbers", "references", "both"])
def test_movement_s_dimensions_come_in_any_order(said_by, tmp_path):
    """xarray writes what it is given; three of each, so that no shape tells an order. netCDF-C
    writes no numbers, old h5netcdf no references.
    """
    names = ("time", "space", "keypoints", "individuals")  # as before movement 0.17
    labels = {"space": "xyz", "keypoints": "abc", "individuals": "ijk"}
    rng = np.random.default_rng(0)
    positions, confidence = rng.normal(size=(3, 3, 3, 3)), rng.random((3, 3, 3))
    gone = {"numbers": "DIMENSION_LIST", "references": "_Netcdf4Coordinates"}.get(said_by)
    for order in itertools.permutations(range(4)):
        with h5netcdf.File(tmp_path / "old.nc", "w") as file:
            file.dimensions = dict.fromkeys((names[k] for k in order), 3)
            for name in ("frame", "time"):  # a variable that is no dimension, and one that is
                file.create_variable(name, ("time",), data=np.arange(3))
            for name, texts in labels.items():
                data = np.array(list(texts), dtype=object)
                file.create_variable(name, (name,), data=data, dtype=h5py.string_dtype())
            data = positions.transpose(0, 3, 2, 1).transpose(order)
            file.create_variable("position", tuple(names[k] for k in order), data=data)
            kept = [k for k in order if names[k] != "space"]
            data = confidence.transpose([(0, -1, 2, 1)[k] for k in kept])
            file.create_variable("confidence", tuple(names[k] for k in kept), data=data)
        with h5py.File(tmp_path / "old.nc", "a") as file:
            for variable in (file["position"], file["confidence"]) if gone else ():
                del variable.attrs[gone]
        back = mc.read_poses(tmp_path / "old.nc")
        assert back.keypoints == ("a", "b", "c")
        np.testing.assert_array_equal(back.positions, positions)
        np.testing.assert_array_equal(back.confidence, confidence)


def test_nwb_is_read_without_its_packages(tmp_path):
    """In millimetres; a series of two dimensions is left out."""
    shutil.copy(CORPUS / "poses/nwb-3d/poses.nwb", tmp_path / "x.nwb")
    whole = mc.read_poses(tmp_path / "x.nwb")
    assert (whole.unit, whole.frames.tolist()) == ("mm", [3, 4, 5, 6, 7])
    place = "processing/behavior/mouse/2D"
    changes = {f"{place}/data": np.ones((5, 2)), f"{place}@neurodata_type": "PoseEstimationSeries"}
    change_store(tmp_path / "x.nwb", changes)
    assert mc.read_poses(tmp_path / "x.nwb") == whole
    beside = known_of(tmp_path, "x.nwb")
    assert (beside["individuals"].tolist(), beside["fps"]) == (["mouse"], 30.0)


def test_a_row_of_a_trc_that_has_a_number_more_is_refused(tmp_path):
    mc.write(example(1), tmp_path / "p.trc", fps=60.0)
    lines = (tmp_path / "p.trc").read_text().splitlines()
    lines[-1] = "\t".join([*lines[-1].split("\t")[:8], "0.5"])
    (tmp_path / "p.trc").write_text("\n".join(lines))
    with pytest.raises(mc.FormatError, match=f"line {len(lines)}: .* 6 numbers .* found 9 cells"):
        mc.read_poses(tmp_path / "p.trc")


@pytest.mark.slow
def test_a_long_c3d_keeps_all_its_frames(tmp_path):
    """More than a 16-bit header counts: the writer that does not say so is the trap."""
    positions = np.zeros((66_000, 1, 1, 3)) + np.arange(66_000)[:, None, None, None]
    mc.write(bare(("a",), positions, "mm"), tmp_path / "long.c3d", fps=100.0)
    back = mc.read_poses(tmp_path / "long.c3d")
    np.testing.assert_array_equal(back.frames, np.arange(66_000))
    np.testing.assert_array_equal(back.positions, positions)


@pytest.mark.parametrize("frame", ["inf", "1e300", "0.5", "nan"])
def test_frames_of_anipose_are_whole_numbers(frame, tmp_path):
    mc.write(bare(("a",), np.ones((2, 1, 1, 3))), tmp_path / "x", "anipose-csv", fps=30.0)
    first, _ = (tmp_path / "x").read_text().rsplit("\n", 1)[0].rsplit(",", 1)
    (tmp_path / "x").write_text(f"{first},{frame}\n")
    with pytest.raises(mc.FormatError, match="a whole number fnum in each row"):
        mc.read_poses(tmp_path / "x")


@pytest.mark.parametrize("name", ["trc", "anipose-csv"])
def test_no_zero_of_a_text_has_a_sign_and_what_is_missing_is_empty(name, tmp_path):
    """Also of a keypoint that is called nan."""
    points = np.full((3, 1, 2, 3), -0.0)
    points[1] = np.nan
    mc.write(bare(("nan", "banana"), points), tmp_path / "x", name, fps=30.0)
    *_, body = (tmp_path / "x").read_text().partition("fnum" if name == "anipose-csv" else "X1")
    assert "-" not in body
    assert "nan" not in body
