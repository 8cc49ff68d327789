"""The laws of keypoint formats, over the table of programs in `samples2d.SAMPLES`.

What is written reads equal; one recording reads equal in all formats; damage is refused in a line
and leaves no file; other programs read what is written.
"""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas
import pytest
import xarray
from golden.command import call
from hypothesis import given, settings
from hypothesis import strategies as st
from samples2d import FRAMES, SAMPLES, SIZE, recording, write_sample
from samples2d import NAMES as SAMPLE_NAMES

import mocap_calib as mc

NAMES = ("nose", "left eye", "tail,base")
WRITTEN = [name for name, sample in SAMPLES.items() if sample.written]
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
    return mc.ReadOptions(layout=NAMES) if SAMPLES[name].options.layout else mc.ReadOptions()


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
    tracked = SAMPLES[name].tracked
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
    if not tracked and instances > 1 and SAMPLES[name].ordered:
        with pytest.raises(mc.MismatchError, match="any order"):
            mc.write(wanted, out, name)
        assert not out.exists()
        return
    lost = mc.write(wanted, out, name)
    layout = mc.ReadOptions(layout=("x", "y", "z") if SAMPLES[name].options.layout else ())
    (found,) = mc.read_keypoints(out, name, layout)
    gone = [
        found.keypoints != wanted.keypoints,
        instances > 1 and wanted.tracked and not found.tracked,
        found.image_size != wanted.image_size,
        found.frames.tolist() != wanted.frames.tolist(),
        bool(wanted.remarks) and not set(wanted.remarks) <= set(found.remarks),
    ]
    assert len(lost) == sum(gone), lost


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("individuals", [1, 2])
def test_one_recording_is_equal_in_all_formats(tmp_path, name, individuals):
    """As the other programs write it; and the format that is named is the one recognised."""
    sample = SAMPLES[name]
    positions, confidence = recording(min(individuals, sample.most), scores=sample.scores)
    paths = write_sample(name, tmp_path, positions, confidence)
    (found,) = mc.read_keypoints(paths, None, sample.options)
    assert (found.camera, found.tracked) == ("cam", sample.tracked)
    assert found.image_size == (SIZE if sample.sized else (0, 0))
    assert (NO_SCORE in found.remarks) != sample.scores
    order = [found.keypoints.index(joint) for joint in SAMPLE_NAMES]  # tables: as they appear
    np.testing.assert_array_equal(found.frames, FRAMES)
    np.testing.assert_allclose(found.positions[:, :, order], positions, rtol=1e-12)
    np.testing.assert_allclose(found.confidence[:, :, order], confidence, rtol=1e-12)
    assert_equal(mc.read_keypoints(paths, sample.format, sample.options)[0], found)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_file_is_of_one_format(tmp_path, name):
    """Of all names that a reader could be given, only its own reads the file."""
    sample = SAMPLES[name]
    paths = write_sample(name, tmp_path, *recording(scores=sample.scores))
    others = {each.format for each in SAMPLES.values()} - {sample.format}
    if sample.format == "coco-results":
        others -= {"alphapose"}  # which has further keys
    options = replace(sample.options, layout=SAMPLE_NAMES, image_size=SIZE)
    for other in others:
        with pytest.raises((mc.FormatError, mc.MismatchError)):
            mc.read_keypoints(paths, other, options)


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("kept", [0.0, 0.4, 0.97])
def test_a_file_that_is_cut_is_refused_and_leaves_no_file(tmp_path, name, kept):
    """Tables that end at a whole line cannot be told from short ones."""
    sample, source = SAMPLES[name], tmp_path / "in"
    write_sample(name, source, *recording(scores=sample.scores))
    victim = min(path for path in source.rglob("*") if path.is_file())
    content = victim.read_bytes()
    victim.write_bytes(content[: int(kept * len(content))].rstrip(b"\r\n0123456789.,"))
    words = ["--layout", ",".join(sample.options.layout)] if sample.options.layout else []
    words += ["--image-size", "640x480"] if sample.options.image_size != (0, 0) else []
    done = call("convert", "in", "out.csv", "--to", "csv", *words, folder=tmp_path)
    if name == "ultralytics" and kept == 0.0:  # an empty label is an image without animals
        assert done.status == 0
        return
    assert done.status == 1
    (line,) = done.stderr
    assert re.search(r": expected .+, found .+; .+", line), line
    folder = kept == 0.0 and victim.parent != source
    assert str((victim.parent if folder else victim).relative_to(tmp_path)) in line
    assert not list(tmp_path.glob("out*"))


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


def _numbers(frame, columns):
    return frame[columns].to_numpy(float)


def _by_pandas_csv(folder):
    table = pandas.read_csv(folder / "cam1.csv", header=[0, 1, 2, 3], index_col=0)
    return table.to_numpy().reshape(len(table), 2, 3, 3)[..., :2]


def _by_pandas_rows(folder):
    table = pandas.read_csv(folder / "keypoints.csv")
    found = np.full((3, 2, 3, 2), np.nan)
    frames = np.searchsorted([0, 1, 2], table["frame"])
    order = [NAMES.index(name) for name in table["keypoint"]]
    found[frames, table["individual"], order] = _numbers(table, ["x", "y"])
    return found


def _by_json(folder):
    data = json.loads((folder / "cam1.json").read_text("utf-8"))
    assert data["categories"][0]["keypoints"] == list(NAMES)
    images = [image["id"] for image in data["images"]]
    found = np.array([each["keypoints"] for each in data["annotations"]]).reshape(3, 2, 3, 3)
    assert images == sorted(each["image_id"] for each in data["annotations"])[::2]
    return np.where(found[..., 2:] > 0, found[..., :2], np.nan)


def _by_openpose(folder):
    people = [
        [each["pose_keypoints_2d"] for each in json.loads(path.read_text())["people"]]
        for path in sorted((folder / "cam1_json").iterdir())
    ]
    found = np.array(people).reshape(3, 2, 3, 3)
    return np.where(found[..., 2:] > 0, found[..., :2], np.nan)


def _by_h5py(folder):
    with h5py.File(folder / "cam1.h5") as file:
        (group,) = file.values()
        labels = [
            group[f"block0_items_level{k}"][...][group[f"block0_items_label{k}"][...]]
            for k in (1, 2, 3)
        ]
        assert labels[1][::3].astype(str).tolist() == [*NAMES] * 2
        assert labels[2][:3].astype(str).tolist() == ["x", "y", "likelihood"]
        return group["block0_values"][...].reshape(3, 2, 3, 3)[..., :2]


def _by_sleap(folder):
    """sleap-io opens several tracks only with names, and saves a project of a named video."""
    with h5py.File(folder / "cam1.analysis.h5") as file:
        assert file["track_names"][...].astype(str).tolist() == ["track_0", "track_1"]
        assert file["node_names"][...].astype(str).tolist() == list(NAMES)
        assert file["video_path"][()] == b"cam1"
        return file["tracks"][...].transpose(3, 0, 2, 1)


def _by_xarray(folder):
    with xarray.open_dataset(folder / "cam1.nc", engine="h5netcdf") as data:
        assert data.attrs["ds_type"] == "poses"
        assert data["confidence"].dims == ("time", "keypoint", "individual")
        assert data["keypoint"].to_numpy().tolist() == list(NAMES)
        return data["position"].transpose("time", "individual", "keypoint", "space").to_numpy()


OTHERS = {
    "coco": _by_json,
    "openpose": _by_openpose,
    "deeplabcut-csv": _by_pandas_csv,
    "deeplabcut-h5": _by_h5py,
    "sleap": _by_sleap,
    "movement": _by_xarray,
    "csv": _by_pandas_rows,
}


@pytest.mark.parametrize("name", WRITTEN)
def test_another_program_reads_what_is_written(tmp_path, name):
    wanted = view(frames=range(3))
    mc.write(wanted, tmp_path / "out", name)
    np.testing.assert_allclose(OTHERS[name](tmp_path / "out"), wanted.positions, atol=1e-9)


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
    assert {sample.format for sample in SAMPLES.values()} == set(named)
