"""All keypoint formats: what is written reads equal, one recording reads equal in all of them."""

from dataclasses import replace

import numpy as np
import pytest
import samples2d
from hypothesis import given, settings
from hypothesis import strategies as st
from samples2d import FRAMES, SAMPLES, SIZE, recording, write_sample

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.file import NO_SCORE
from mocap_calib.io.keypoints import losses
from mocap_calib.io.keypoints.document import Document, ReadOptions
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.io.registry import format_names, written_names
from mocap_calib.types import Keypoints2D

NAMES = ("nose", "left eye", "tail,base")


def view(
    camera="cam1", frames=(3, 4, 10), instances=2, missing=0.3, tracked=True, size=(0, 0), seed=0
):
    """Random detections; the first frame has all points, so that nobody is without any."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(1, 400, (len(frames), instances, len(NAMES), 2))
    confidence = rng.uniform(0.1, 0.99, positions.shape[:3])
    gone = rng.random(confidence.shape) < missing
    gone[0] = False
    positions[gone], confidence[gone] = np.nan, 0.0
    return Keypoints2D(
        camera,
        NAMES,
        np.array(frames, dtype=np.int64),
        positions,
        confidence,
        tracked,
        size,
        "made",
    )


def assert_equal(found: Keypoints2D, wanted: Keypoints2D, atol=0.0):
    assert (found.camera, found.keypoints, found.tracked) == (
        wanted.camera,
        wanted.keypoints,
        wanted.tracked,
    )
    np.testing.assert_array_equal(found.frames, wanted.frames)
    np.testing.assert_allclose(found.positions, wanted.positions, rtol=0, atol=atol)
    np.testing.assert_allclose(found.confidence, wanted.confidence, rtol=0, atol=atol)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.booleans(), st.integers(1, 3), st.floats(0, 1))
def test_csv_reads_what_it_wrote(tmp_path_factory, seed, tracked, instances, missing):
    path = tmp_path_factory.mktemp("csv") / "keypoints.csv"
    views = tuple(
        view(name, frames, instances, missing, tracked, seed=seed)
        for name, frames in (("left", (0, 5, 6)), ('a "b", c', (2, 3)))
    )
    write_keypoints(path, views, "csv")
    for found, wanted in zip(read_keypoints([path]), views, strict=True):
        assert_equal(found, wanted)


WRITTEN = written_names(KEYPOINT_FORMATS)
FOLLOWED_ONLY = [each.name for each in KEYPOINT_FORMATS if each.followed]
NEEDS_NAMES = [each.name for each in KEYPOINT_FORMATS if losses.NAMES in each.loses]
ANY_ORDER = [each.name for each in KEYPOINT_FORMATS if losses.FOLLOWED in each.loses]


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(WRITTEN), st.integers(0, 1000), st.integers(1, 3), st.floats(0, 1))
def test_every_writer_is_read_as_it_was(tmp_path_factory, name, seed, instances, missing):
    """Values to the last bit; COCO has nine decimals."""
    folder = tmp_path_factory.mktemp("written")
    sleap = name == "sleap"  # which counts frames from 0
    views = tuple(
        view(camera, frames, instances, missing, name not in ANY_ORDER, seed=seed)
        for camera, frames in (
            ("left", range(4) if sleap else (0, 5, 6)),
            ("right", range(2) if sleap else (42150, 42152)),
        )
    )
    write_keypoints(folder / "out", views, name)
    files = list((folder / "out").iterdir())
    options = ReadOptions(layout=NAMES if name in NEEDS_NAMES else ())
    found = read_keypoints(files if len(files) == 1 else [folder / "out"], None, options)
    assert len(found) == 2
    for each, wanted in zip(found, views, strict=True):
        assert_equal(each, wanted, atol=1e-9 if name == "coco" else 0.0)


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(WRITTEN),
    st.booleans(),
    st.booleans(),
    st.sampled_from([range(3), (0, 2, 3), (1, 2)]),
    st.integers(1, 2),
    st.booleans(),
)
def test_a_writer_says_what_does_not_come_back_and_nothing_else(
    tmp_path_factory, name, tracked, sized, frames, instances, scored
):
    if not tracked and instances > 1 and name in FOLLOWED_ONLY:
        return  # refused: see below
    wanted = view(
        frames=frames,
        instances=instances,
        missing=0,
        tracked=tracked,
        size=SIZE if sized else (0, 0),
    )
    if not scored:
        wanted = replace(wanted, confidence=np.ones_like(wanted.confidence), remarks=(NO_SCORE,))
    folder = tmp_path_factory.mktemp("lost")
    lost = write_keypoints(folder / "out", (wanted,), name)
    (found,) = read_keypoints(
        [folder / "out"], name, ReadOptions(layout=("x", "y", "z") if name in NEEDS_NAMES else ())
    )
    gone = {
        "the names of keypoints": found.keypoints != wanted.keypoints,
        "who is who from frame to frame": instances > 1 and wanted.tracked and not found.tracked,
        "image sizes": found.image_size != wanted.image_size,
        "which frames are absent: they become empty ones": found.frames.tolist()
        != wanted.frames.tolist(),
        "that there are no scores: each point gets 1": NO_SCORE in wanted.remarks
        and NO_SCORE not in found.remarks,
    }
    assert set(lost) == {what for what, is_gone in gone.items() if is_gone}


def test_a_table_of_all_cameras_follows_nobody_where_one_does_not(tmp_path):
    lost = write_keypoints(tmp_path / "all.csv", (view("a"), view("b", tracked=False)), "csv")
    assert any("who is who" in what for what in lost)
    assert not any(each.tracked for each in read_keypoints([tmp_path / "all.csv"]))


@pytest.mark.parametrize("name", WRITTEN)
def test_a_folder_with_another_recording_is_refused(tmp_path, name):
    """One with the same files is written anew; what is not read along may lie there."""
    whole = (view("a", frames=range(3)), view("b", frames=range(3)))
    for _ in range(2):
        write_keypoints(tmp_path / "out", whole, name)
        (tmp_path / "out" / "notes.txt").write_text("not read")
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    other = "coco" if name == "csv" else name  # whose one file would be replaced
    for views in (whole[:1], (replace(view("a", frames=range(2)), camera="c"),)):
        with pytest.raises(
            MismatchError, match="expected a new folder or one with the same files, found"
        ):
            write_keypoints(tmp_path / "out", views, other)
    assert before == {
        path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()
    }


def test_frames_of_a_longer_recording_are_refused_too(tmp_path):
    write_keypoints(tmp_path / "out", (view("a", frames=range(3)),), "openpose")
    with pytest.raises(MismatchError, match="found a_json/a_000000000002_keypoints"):
        write_keypoints(tmp_path / "out", (view("a", frames=range(2)),), "openpose")


def test_one_recording_is_equal_in_all_formats(tmp_path):
    wanted = view(frames=range(5), instances=1, missing=0.4)
    for name in WRITTEN:
        write_keypoints(tmp_path / name, (wanted,), name)
        path = tmp_path / name
        found = read_keypoints(
            [path], name, ReadOptions(layout=NAMES if name in NEEDS_NAMES else ())
        )
        assert len(found) == 1
        assert_equal(replace(found[0], tracked=True), wanted, atol=1e-9 if name == "coco" else 0.0)


@pytest.mark.parametrize("name", FOLLOWED_ONLY)
def test_detections_in_any_order_are_not_written_as_individuals(tmp_path, name):
    with pytest.raises(MismatchError, match="any order"):
        write_keypoints(tmp_path / "out", (view(tracked=False),), name)
    assert not (tmp_path / "out").exists()


def test_a_format_that_is_not_known_or_not_written_is_refused(tmp_path):
    with pytest.raises(MismatchError, match="choose one"):
        write_keypoints(tmp_path / "out", (view(),), "mmpose")
    with pytest.raises(MismatchError, match="choose one"):
        read_keypoints([tmp_path], "word")
    (tmp_path / "a.json").write_text('{"version": 1}')
    with pytest.raises(FormatError, match="one of: coco"):
        read_keypoints([tmp_path / "a.json"])


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("individuals", [1, 2])
def test_what_other_programs_write_of_one_recording_is_equal(tmp_path, name, individuals):
    _, _, options, most, scores, tracked = SAMPLES[name]
    individuals = min(individuals, most)
    positions, confidence = recording(individuals, scores=scores)
    (found,) = read_keypoints(write_sample(name, tmp_path, positions, confidence), None, options)
    assert (found.camera, found.tracked) == ("cam", tracked)
    assert found.image_size == (SIZE if name in ("coco", "nwb", "ultralytics") else (0, 0))
    order = [
        found.keypoints.index(joint) for joint in samples2d.NAMES
    ]  # tables name joints as they appear
    np.testing.assert_array_equal(found.frames, FRAMES)
    np.testing.assert_allclose(found.positions[:, :, order], positions, rtol=1e-12)
    np.testing.assert_allclose(found.confidence[:, :, order], confidence, rtol=1e-12)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_format_can_be_forced_and_is_the_one_that_is_sniffed(tmp_path, name):
    known, _, options, _, scores, _ = SAMPLES[name]
    paths = write_sample(name, tmp_path, *recording(scores=scores))
    sniffed, forced = (read_keypoints(paths, each, options)[0] for each in (None, known))
    np.testing.assert_array_equal(sniffed.positions, forced.positions)
    others = [
        each.name
        for each in KEYPOINT_FORMATS
        if each.name != known and each.sniff(_document(paths[0]))
    ]
    assert set(others) <= ({"alphapose"} if known == "coco-results" else set())


def _document(path):
    return Document(
        path if path.is_file() else min(each for each in path.rglob("*") if each.is_file())
    )


def test_every_format_has_a_sample():
    assert {known for known, *_ in SAMPLES.values()} == set(format_names(KEYPOINT_FORMATS))
