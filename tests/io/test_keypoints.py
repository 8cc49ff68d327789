"""The laws of keypoint formats, over the table of formats in `conformance.KEYPOINTS`.

What is written reads equal; one recording reads equal in all formats; damage is refused in a line
and leaves no file; other programs read what is written.
"""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
import xarray
from conformance import CORPUS, FRAMES, KEYPOINTS, SIZE, TARGETS, recording
from conformance import NAMES as JOINTS
from hypothesis import given, settings
from hypothesis import strategies as st

import mocap_calib as mc

NAMES = ("nose", "left eye", "tail,base")
WRITTEN = TARGETS["keypoints"]
NO_SCORE = "no scores in the file: every point counts fully"


def view(camera="cam1", frames=(3, 4, 10), instances=2, missing=0.3, tracked=True, **changes):
    """Return random detections; each individual has all points in the first frame."""
    rng = np.random.default_rng(changes.pop("seed", 0))
    positions = rng.uniform(1, 400, (len(frames), instances, len(NAMES), 2))
    confidence = rng.uniform(0.1, 0.99, positions.shape[:3])
    gone = rng.random(confidence.shape) < missing
    gone[0] = False
    positions[gone], confidence[gone] = np.nan, 0.0
    made = mc.Keypoints2D(
        *(camera, NAMES, np.array(frames, dtype=np.int64), positions, confidence),
        *(tracked, (0, 0), "made"),
    )
    return replace(made, **changes)


def options_of(name):
    return mc.ReadOptions(layout=() if KEYPOINTS[name].named else NAMES)


def assert_equal(found, wanted, atol=0.0):
    for field in ("camera", "keypoints", "tracked"):
        assert getattr(found, field) == getattr(wanted, field)
    np.testing.assert_array_equal(found.frames, wanted.frames)
    np.testing.assert_allclose(found.positions, wanted.positions, rtol=0, atol=atol)
    np.testing.assert_allclose(found.confidence, wanted.confidence, rtol=0, atol=atol)


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(WRITTEN), st.integers(0, 1000), st.integers(1, 3), st.floats(0, 1))
def test_what_is_written_reads_equal(tmp_path_factory, name, seed, instances, missing):
    """To the last bit; COCO has nine decimals."""
    folder = tmp_path_factory.mktemp("written")
    sleap = name == "sleap"  # which counts frames from 0
    tracked = KEYPOINTS[name].tracked
    views = tuple(
        view(camera, frames, instances, missing, tracked, seed=seed)
        for camera, frames in (
            ('a "b", c' if name == "csv" else "left", range(4) if sleap else (0, 5, 6)),
            ("right", range(2) if sleap else (42150, 42152)),
        )
    )
    once, again = (folder / place / ("x.csv" * (name == "csv")) for place in "ab")
    for target in (once, again):
        mc.write(views, target, name)
    assert list(contents(folder / "a").values()) == list(contents(folder / "b").values())
    back = mc.read_keypoints(once, options=options_of(name))
    for found, wanted in zip(back, views, strict=True):
        assert_equal(found, wanted, atol=1e-9 if name == "coco" else 0.0)


@settings(max_examples=40, deadline=None)
@given(
    *(st.sampled_from(WRITTEN), st.booleans(), st.booleans()),
    *(st.sampled_from([range(3), (0, 2, 3), (1, 2)]), st.integers(1, 2), st.booleans()),
)
def test_a_writer_reports_what_does_not_come_back_and_nothing_else(
    tmp_path_factory, name, tracked, sized, frames, instances, scored
):
    wanted = view("a", frames, instances, 0, tracked, image_size=SIZE if sized else (0, 0))
    if not scored:
        wanted = replace(wanted, confidence=np.ones_like(wanted.confidence), remarks=(NO_SCORE,))
    out = tmp_path_factory.mktemp("lost") / "out"
    if not tracked and instances > 1 and KEYPOINTS[name].ordered:
        with pytest.raises(mc.MismatchError, match="any order"):
            mc.write(wanted, out, name)
        assert not out.exists()
        return
    lost = mc.write(wanted, out, name)
    layout = mc.ReadOptions(layout=() if KEYPOINTS[name].named else ("x", "y", "z"))
    (found,) = mc.read_keypoints(out, name, layout)
    gone = [
        found.keypoints != wanted.keypoints,
        instances > 1 and wanted.tracked and not found.tracked,
        found.image_size != wanted.image_size,
        found.frames.tolist() != wanted.frames.tolist(),
        bool(wanted.remarks) and not set(wanted.remarks) <= set(found.remarks),
    ]
    assert len(lost) == sum(gone), lost


@pytest.mark.parametrize("name", KEYPOINTS)
def test_one_recording_is_equal_in_all_formats(name):
    """As the other programs write it; of the readers' names, its own alone reads it."""
    carries, paths = KEYPOINTS[name], sorted((CORPUS / "keypoints" / name).iterdir())
    form, options = carries.format or name, mc.ReadOptions(**carries.options)
    (found,) = mc.read_keypoints(paths, None, options)
    assert (found.camera, found.tracked) == (carries.camera, carries.tracked)
    assert found.image_size == (SIZE if carries.sized else (0, 0))
    assert (NO_SCORE in found.remarks) != carries.scores
    order = [found.keypoints.index(joint) for joint in JOINTS]  # tables: as they appear
    positions, confidence = recording(carries.individuals, carries.scores)
    np.testing.assert_array_equal(found.frames, FRAMES)
    np.testing.assert_allclose(found.positions[:, :, order], positions, rtol=1e-12)
    np.testing.assert_allclose(found.confidence[:, :, order], confidence, rtol=1e-12)
    assert_equal(mc.read_keypoints(paths, form, options)[0], found)
    others = {each.format or other for other, each in KEYPOINTS.items()} - {form}
    others -= {"alphapose"} if form == "coco-results" else set()  # which has further keys
    for other in others:
        with pytest.raises((mc.FormatError, mc.MismatchError)):
            mc.read_keypoints(paths, other, mc.ReadOptions(layout=JOINTS, image_size=SIZE))


@pytest.mark.parametrize("name", WRITTEN)
def test_a_folder_with_another_recording_is_refused(tmp_path, name):
    """One with the same files is written anew; what is not read along may lie there."""
    whole = (view("a", frames=range(3)), view("b", frames=range(3)))
    for _ in range(2):
        mc.write(whole, tmp_path / "out", name)
        (tmp_path / "out" / "notes.txt").write_text("not read")
    before = contents(tmp_path / "out")
    other = "coco" if name == "csv" else name  # whose one file would be replaced
    for views in (whole[:1], (view("c", frames=range(2)),)):
        with pytest.raises(mc.MismatchError, match="a new folder or one with the same files"):
            mc.write(views, tmp_path / "out", other)
    assert before == contents(tmp_path / "out")


def _by_pandas(folder):
    table = pandas.read_csv(folder / "cam1.csv", header=[0, 1, 2, 3], index_col=0)
    return table.to_numpy().reshape(len(table), 2, 3, 3)[..., :2]


def _by_xarray(folder):
    with xarray.open_dataset(folder / "cam1.nc", engine="h5netcdf") as data:
        assert data.attrs["ds_type"] == "poses"
        assert data["confidence"].dims == ("time", "keypoint", "individual")
        assert data["keypoint"].to_numpy().tolist() == list(NAMES)
        return data["position"].transpose("time", "individual", "keypoint", "space").to_numpy()


@pytest.mark.parametrize("name", ["deeplabcut-csv", "movement"])
def test_another_program_reads_what_is_written(tmp_path, name):
    wanted = view(frames=range(3))
    mc.write(wanted, tmp_path, name)
    read = _by_pandas if name == "deeplabcut-csv" else _by_xarray
    np.testing.assert_allclose(read(tmp_path), wanted.positions, atol=1e-9)


@pytest.mark.parametrize("name", ["coco", "openpose", "deeplabcut-csv", "csv"])
def test_no_zero_of_a_text_has_a_sign(tmp_path, name):
    mc.write(replace(view(frames=range(2)), positions=np.full((2, 2, 3, 2), -0.0)), tmp_path, name)
    for content in contents(tmp_path).values():
        assert not re.search(rb"-0(\.0*)?(?![\d.e-])", content)


def test_a_table_of_all_cameras_follows_no_one_where_one_camera_does_not(tmp_path):
    assert mc.write([view("a"), view("b", tracked=False)], tmp_path / "all.csv", "csv")
    assert not any(each.tracked for each in mc.read_keypoints(tmp_path / "all.csv"))
    with (tmp_path / "all.csv").open(newline="") as file:
        assert "instance" in next(csv.reader(file))


def test_a_format_that_is_not_known_or_not_written_is_refused(tmp_path):
    with pytest.raises(mc.MismatchError, match="mmpose: expected a format that is written"):
        mc.write(view(), tmp_path / "out", "mmpose")
    with pytest.raises(mc.MismatchError, match="word"):
        mc.read_keypoints([tmp_path], "word")


def test_the_table_has_every_format():
    with pytest.raises(mc.MismatchError) as refused:
        mc.read_keypoints([Path("x")], "no such format")
    named = re.search(r"formats (.+), found", str(refused.value))[1].split(", ")
    assert {each.format or name for name, each in KEYPOINTS.items()} == set(named)
