"""Views joined to a recording: by name, by number, by meaning; and which of its frames are used."""

import re
from ast import literal_eval
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import PEOPLE, calibrate_group, recording, rotation_errors_deg, scene, truth

import mocap_calib as mc
from mocap_calib.clocks.estimate import clocks_from, clocks_of_rates, own_frames, retime
from mocap_calib.config import SampleConfig, SyncConfig
from mocap_calib.errors import MismatchError
from mocap_calib.faults.hypotheses import option_of
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.io.results.matches_csv import matches_csv, read_matches_csv
from mocap_calib.recording.corrections import (
    Cropped,
    Exchanged,
    Flipped,
    Mirrored,
    Moved,
    Refocused,
    Resized,
    Rotated,
    Sides,
    apply_mends,
    exchanged_sides,
)
from mocap_calib.recording.epochs import (
    list_epochs,
    own_name,
    recording_of_epoch,
    rig_of_epoch,
    views_by_camera,
)
from mocap_calib.recording.image_sizes import join_sized
from mocap_calib.recording.joints import edges_of_keypoints, match_names
from mocap_calib.recording.names import assume_cameras, match_cameras, views_with_detections
from mocap_calib.recording.sampling import (
    choose_sample_frames,
    choose_stretches,
    take_sample,
)
from mocap_calib.recording.synchronise import find_copies, find_repeated, make_recording
from mocap_calib.results import NO_FRAME, Clocks
from mocap_calib.types import (
    Camera,
    CameraClock,
    CameraRig,
    EstimatedCamera,
    Keypoints2D,
    Recording,
    Sample,
    Skeleton,
)

SKELETON = Skeleton(
    "test", ("nose", "neck", "left_ear", "right_ear"), (), (), {"thorax": "neck", "sternum": "neck"}
)
MATRIX = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
law = settings(max_examples=20, deadline=None, derandomize=True)
same = np.testing.assert_array_equal


def camera(name, size=(640, 480)):
    return Camera(name, size, MATRIX, np.array([-0.1, 0.01, 0, 0, 0]), False)


def view(name, frames=(0, 1, 2), keypoints=("nose", "neck"), instances=1, seed=0, size=(640, 480)):
    rng = np.random.default_rng([seed, *name.encode()])
    shape = len(frames), instances, len(keypoints)
    positions = rng.uniform(100, 400, (*shape, 2)).astype(np.float32)
    confidence = rng.uniform(0.2, 1.0, shape)
    return Keypoints2D(
        name, tuple(keypoints), np.array(frames), positions, confidence, False, size, f"{name}.json"
    )


def record(*views, cameras=None, aliases=None) -> Sample:
    cameras = cameras or [camera(v.camera) for v in views]
    return take_sample(make_recording(views, cameras, SKELETON, aliases or {}), slice(None))


# laws


@law
@given(st.permutations(range(3)), st.permutations(range(3)), st.permutations(range(3)))
def test_only_the_order_of_cameras_matters_not_that_of_files_or_keypoints(
    files, cameras, keypoints
):
    names = ("nose", "neck", "whisker")
    views = [view("abc"[k], instances=k + 1, keypoints=names) for k in range(3)]
    first = record(*views)
    turned = replace(
        views[1],
        keypoints=tuple(names[k] for k in keypoints),
        positions=views[1].positions[:, :, keypoints],
        confidence=views[1].confidence[:, :, keypoints],
    )
    given = [(views[0], turned, views[2])[k] for k in files]
    second = record(*given, cameras=[camera("abc"[k]) for k in cameras])
    assert second.names == tuple("abc"[k] for k in cameras)
    order = [second.keypoints.index(name) for name in names]
    assert first.keypoints == names
    same(second.tracked, first.tracked)
    same(second.vocabulary[order], first.vocabulary)
    for name in ("positions", "confidence", "rays"):
        same(getattr(second, name)[:, :, :, order], getattr(first, name)[list(cameras)])


@law
@given(st.lists(st.sets(st.integers(0, 30), min_size=1), min_size=2, max_size=4))
def test_frames_are_those_of_two_views_by_number(sets):
    views = [view("abcd"[k], frames=sorted(frames)) for k, frames in enumerate(sets)]
    shared = sorted(n for n in range(31) if sum(n in frames for frames in sets) >= 2)
    if not shared:
        with pytest.raises(MismatchError):
            record(*views)
        return
    found = record(*views)
    assert found.frames.tolist() == shared
    for v, (one, frames) in enumerate(zip(views, sets, strict=True)):
        there = [number in frames for number in shared]
        own = np.searchsorted(one.frames, np.array(shared)[there])
        same(found.positions[v, there], one.positions[own])
        assert not found.seen[v, np.logical_not(there)].any()


def test_rays_project_back_to_the_positions_and_what_is_missing_stays_missing():
    """Instances are padded. What a lens model cannot undo is no detection."""
    a, b = view("a", instances=3), view("b")
    a.positions[1, 0, 1], a.confidence[1, 0, 1] = np.nan, 0
    a.positions[1, 2, 1] = [900, 240]
    bent = [replace(camera(name), distortion=np.array([-0.3, 0, 0, 0])) for name in "ab"]
    found = record(a, b, cameras=bent)
    assert found.positions.shape == (2, 3, 3, 2, 2)
    expected = np.isfinite(a.positions[..., 0])
    expected[1, 2, 1] = False
    same(found.seen[0], expected)
    same(found.seen[1, :, 1:], False)
    same(found.confidence > 0, found.seen)
    same(np.isfinite(found.rays).all(-1), found.seen)
    for v, one in enumerate(found.cameras):
        back = pixels_from_points(one, found.rays[v])[found.seen[v]]
        np.testing.assert_allclose(back, found.positions[v][found.seen[v]], atol=1e-9)


@pytest.mark.parametrize("scale", [0.5, 1.0, 6.0])
def test_confidence_up_to_1_is_kept_and_beyond_is_scaled_by_view(scale):
    a, b = view("a", frames=range(200)), view("b", frames=range(200))
    found = record(replace(a, confidence=a.confidence * scale), b)
    same(found.confidence[1], b.confidence.astype(np.float32))
    most = np.percentile(a.confidence, 99) if scale > 1 else 1 / scale
    np.testing.assert_allclose(found.confidence[0], (a.confidence / most).clip(max=1), rtol=1e-6)


# names of keypoints


@pytest.mark.parametrize(
    ("names", "keypoints", "vocabulary"),
    [
        ([("thorax", "LEar"), ("left ear", "neck")], ("thorax", "LEar"), [1, 2]),
        ([("TailTip", "nose"), ("nose", "tail_tip")], ("TailTip", "nose"), [-1, 0]),
        ([("nose", "neck", "x"), ("y", "nose", "neck")], ("nose", "neck"), [0, 1]),
        ([("neck", "thorax"), ("thorax", "neck"), ("thorax",)], ("neck", "thorax"), [1, -1]),
        ([("LEar", "left_ear", "nose")] * 2, ("LEar", "left_ear", "nose"), [-1, 2, 0]),
        ([("Gola", "nose"), ("neck", "nose")], ("Gola", "nose"), [1, 0]),
    ],
)
def test_names_of_one_joint_are_one_keypoint_but_side_by_side_they_stay_apart(
    names, keypoints, vocabulary
):
    """Beyond the vocabulary as they are spelled; of one view only they are left out.

    Own aliases come first.
    """
    views = [view("abc"[k], keypoints=each) for k, each in enumerate(names)]
    found = record(*views, aliases={"gola": "neck"})
    assert found.keypoints == keypoints
    assert sorted(found.vocabulary.tolist()) == sorted(vocabulary)
    if len(views) == 3:
        same(found.positions[2, :, :, 1], views[2].positions[:, :, 0])
        assert not found.seen[2, :, :, 0].any()
    else:
        assert found.seen.all()


def test_edges_join_the_keypoints_that_there_are():
    """Over those that are missing."""

    def named_edges(names: tuple[str, ...]) -> set[frozenset[str]]:
        edges = edges_of_keypoints(PEOPLE, match_names(names, PEOPLE))
        return {frozenset((names[a], names[b])) for a, b in edges}

    assert len(named_edges(PEOPLE.keypoints)) == len(PEOPLE.keypoints) - 1
    assert named_edges(("spine", "left_wrist", "left_shoulder", "something")) == {
        frozenset(("spine", "left_shoulder")),  # over the neck
        frozenset(("left_shoulder", "left_wrist")),  # over the elbow
    }
    trunk = {frozenset(("left_hip", "right_hip")), frozenset(("left_shoulder", "left_hip"))}
    assert trunk <= named_edges(PEOPLE.keypoints[:17])  # of COCO


# cameras


def test_cameras_are_matched_by_name_and_extra_ones_dropped():
    views = [view("Left"), view("right")]
    cameras = [camera("top"), camera("RIGHT"), camera("Left"), camera("left")]
    assert match_cameras(views, cameras) == ("Left", "RIGHT")
    assert record(*views, cameras=cameras).names == ("RIGHT", "Left")


@pytest.mark.parametrize(
    ("files", "known", "found"),
    [
        (["Video110374DLC_x", "Video110376DLC_x"], ["10374", "10376"], ["10374", "10376"]),
        (["1_Fly A_Cam-A_rot", "1_Fly A_Cam-B_rot"], "CBA", ["A", "B"]),
        (
            ["rec_cam1", "rec_cam10", "rec_cam2"],
            ["cam10", "cam2", "cam1"],
            ["cam1", "cam10", "cam2"],
        ),
        (["x_Cam_01_y", "cam02"], ["cam01", "cam02"], ["cam01", "cam02"]),
        (["cafe\u0301_links", "cafe\u0301_mitte"], ["Mitte", "LINKS"], ["LINKS", "Mitte"]),
        (["a1", "b1"], ["1", "2"], None),  # where they do not differ
        (["left", "cam1"], ["cam1", "cam2"], None),
        (["rec_cam10", "rec_cam11"], ["cam1", "cam11"], None),
    ],
)
def test_cameras_are_found_where_the_names_of_files_differ(files, known, found):
    views, cameras = [view(name) for name in files], [camera(name) for name in known]
    if found:
        assert match_cameras(views, cameras) == tuple(found)
    else:
        with pytest.raises(MismatchError):
            match_cameras(views, cameras)


def test_two_files_of_a_camera_are_told_apart_by_the_user():
    days = [view(f"rat_05-0{day}_cam{k}DLC") for day in (1, 2) for k in (1, 2)]
    with pytest.raises(MismatchError, match=r"05-01_cam1DLC.* and .*05-02_cam1DLC.*one recording"):
        match_cameras(days, [camera("cam1"), camera("cam2")])
    one_file = [replace(view(name), source="all.slp") for name in ("up", "down")]
    with pytest.raises(MismatchError, match="rename the cameras of the intrinsics"):
        match_cameras(one_file, [camera("left"), camera("right")])


def test_a_pattern_that_joins_names_of_files_and_cameras_is_suggested_where_there_is_one():
    known = [camera(name) for name in ("cam1", "cam10", "c.2")]

    def suggested(*paths: str) -> list[str]:
        views = [replace(view(Path(path).stem), source=path) for path in paths]
        with pytest.raises(MismatchError) as refused:
            match_cameras(views, known)
        found = re.search(r"camera_regex=('[^']+')", str(refused.value))
        return [re.search(literal_eval(found[1]), path)[0] for path in paths] if found else []

    assert suggested("s/rat3_cam1_2024.json", "s/rat3_cam10_2024.json") == ["cam1", "cam10"]
    assert suggested("s/left.json", "s/cam1.json") == []
    assert suggested("cam1/left.json", "cam1/right.json") == []


def test_a_view_without_detections_is_dropped():
    nan, zero = np.full((3, 1, 2, 2), np.nan), np.zeros((3, 1, 2))
    empty = replace(view("c"), positions=nan, confidence=zero)
    none = replace(view("d"), positions=nan[:, :0], confidence=zero[:, :0])
    assert record(view("a"), empty, none, view("b")).names == ("a", "b")
    assert [v.camera for v in views_with_detections([view("a"), empty, none])] == ["a"]


def test_sizes_are_those_of_the_files_and_sources_need_not_be_known():
    cameras = [camera("a", (0, 0)), camera("b", (0, 0))]
    found = record(view("a"), view("b", size=(0, 0)), cameras=cameras)
    assert [each.size for each in found.cameras] == [(640, 480), (0, 0)]
    assert record(*(replace(view(name), source="") for name in "ab")).names == ("a", "b")


def test_cameras_of_which_nothing_is_known_look_along_the_middle_of_their_images():
    first, second = scene(cameras=2, frames=5).files
    upright = replace(second, image_size=(720, 1280))
    wide, tall = assume_cameras((first, upright))
    assert (wide.name, wide.size, tall.size) == ("cam1", (1280, 720), (720, 1280))
    same(wide.matrix, [[1536, 0, 639.5], [0, 1536, 359.5], [0, 0, 1]])
    same(tall.matrix, [[1536, 0, 359.5], [0, 1536, 639.5], [0, 0, 1]])
    same(wide.distortion, 0)
    with pytest.raises(MismatchError, match="cam2"):
        assume_cameras((first, replace(second, image_size=(0, 0))))


def at(name: str, factor: float = 1.0, **changes) -> Keypoints2D:
    """Return a view whose positions are multiplied, of which nothing says how large images are."""
    one = view(name, size=(0, 0), frames=range(200))
    return replace(one, positions=one.positions * factor, **changes)


def never_at_once() -> list[Keypoints2D]:
    a, b = view("a"), view("b")
    a.positions[1:], b.positions[:1] = np.nan, np.nan
    return [a, b]


@pytest.mark.parametrize(
    ("views", "cameras", "named"),
    [
        ([view("a")], None, ["a"]),
        ([view("a"), view("b")], "ac", ["a, b", "a, c"]),
        ([view("left"), view("LEFT")], ["left"], ["LEFT.json"]),
        ([view("CAM"), view("b")], ["cam", "Cam", "b"], ["CAM"]),
        ([view("a", (0, 1)), view("b", (100, 104))], None, ["a 0-1", "b 100-104"]),
        (never_at_once(), None, []),
        ([view("a", keypoints=("x",)), view("b", keypoints=("u",))], None, ["x", "u"]),
        ([at("a", 1 / 640), at("b")], None, ["pixels"]),
    ],
)
def test_what_does_not_belong_together_is_refused_in_a_line_that_names_it(views, cameras, named):
    with pytest.raises(MismatchError) as refused:
        record(*views, cameras=cameras and [camera(name) for name in cameras])
    message = str(refused.value)
    assert "\n" not in message
    assert all(each in message for each in named)


# sizes of images beside those of intrinsics, 640 x 480


def sized(size, *mends, factor=1.0, **said) -> mc.Recording:
    """Return the recording of a camera whose images have a size ((0, 0): none), and a sound one."""
    one = replace(at("a", factor), image_size=size)
    cameras = [camera("a", said.pop("given", (640, 480))), camera("b")]
    return join_sized([one, view("b")], cameras, SKELETON, {}, mends=mends, **said)


@pytest.mark.parametrize(
    ("size", "mends"),
    [
        ((480, 640), [mc.Rotated("a", 90)]),
        ((240, 320), [mc.Rotated("a", 90), mc.Resized("a", 0.5)]),
        ((320, 240), [mc.Resized("a", 0.5)]),
        ((854, 640), [mc.Resized("a", np.sqrt(854 * 640 / (640 * 480)))]),  # 853.3, rounded
        ((400, 480), [mc.Cropped("a", 120, 0, 240 / np.sqrt(12))]),
        ((1280, 800), [mc.Resized("a", 2.0), mc.Cropped("a", 0, 80, 160 / np.sqrt(12))]),
        ((640, 470), []),  # cut off from whole blocks
        ((0, 0), []),
    ],
)
def test_sizes_that_differ_show_how_the_intrinsics_are_corrected(size, mends):
    found = sized(size)
    assert [fault.mend for fault in found.corrected] == mends
    assert found.cameras[0].size == (size if mends else (640, 480))
    plain = mc.Recording.from_keypoints([view("a"), view("b")], [camera("a"), camera("b")])
    for mend in mends:
        plain = mend.apply(plain)
    same(found.cameras[0].matrix, plain.cameras[0].matrix)


@pytest.mark.parametrize(
    ("size", "mends"),
    [
        ((480, 640), [mc.Rotated("a", 270)]),
        ((320, 240), [mc.Resized("a", 0.5)]),
        ((240, 320), [mc.Rotated("a", 90), mc.Resized("a", 0.5)]),
        ((320, 480), [mc.Resized("a", 0.5, 1.0)]),
    ],
)
@pytest.mark.parametrize("given", [(640, 480), (0, 0)])
def test_what_is_stated_of_images_is_applied_before_sizes_are_compared(size, mends, given):
    found = sized(size, *mends, given=given)
    assert (found.corrected, found.cameras[0].size) == ((), size)
    assert sized((400, 300), given=given, cropped={"a"}).corrected == ()


def test_an_image_is_mirrored_as_it_is_after_it_was_turned():
    found = sized((480, 640), mc.Mirrored("a", sides=False), mc.Rotated("a", 90))
    same(found.positions[0, :3, ..., 0], 479 - at("a").positions[:3, ..., 0])


@pytest.mark.parametrize(
    ("size", "mends", "factor", "named"),
    [
        ((640, 480), [mc.Rotated("a", 90)], 1.0, ["480 x 640", "640 x 480"]),
        ((320, 240), [mc.Resized("a", 0.25)], 1.0, ["160 x 120", "320 x 240"]),
        ((0, 0), [], 3.0, ["640 x 480", "resized='a:FACTOR'"]),
    ],
)
def test_sizes_that_contradict_what_is_stated_are_refused(size, mends, factor, named):
    with pytest.raises(MismatchError) as refused:
        sized(size, *mends, factor=factor)
    assert all(each in str(refused.value) for each in named)


def test_keypoints_beyond_an_image_of_unknown_size_show_a_quarter_turn():
    tall = at("a")
    tall.positions[..., 1] *= 2  # up to 800, as wide as 400
    found = join_sized([tall, view("b")], [camera("a"), camera("b")], SKELETON, {})
    assert [fault.mend for fault in found.corrected] == [mc.Rotated("a", 90)]
    assert found.cameras[0].size == (480, 640)


def test_a_single_wild_point_shows_nothing():
    wild = at("a")
    wild.positions[0, 0, 0] = 5000
    assert join_sized([wild, at("b")], [camera("a"), camera("b")], SKELETON, {}).corrected == ()


# files and detections that are there twice


def copy_of(one: Keypoints2D, other: Keypoints2D, **changes) -> Keypoints2D:
    """Return the detections of a view under the name of another one."""
    return replace(one, camera=other.camera, source=other.source, **changes)


def copies(*views: Keypoints2D, **options) -> list[str]:
    meanings = {name: name for name in views[0].keypoints}
    return find_copies(views, meanings, **options)


def part_of(one: Keypoints2D, frames: slice) -> dict[str, np.ndarray]:
    return {name: getattr(one, name)[frames] for name in ("frames", "positions", "confidence")}


def test_a_copy_is_found_in_any_order_at_any_shift_and_to_other_digits():
    first, second, *_ = scene(people=2).files
    for changes in (
        {"positions": first.positions[:, ::-1]},
        {"positions": np.round(first.positions, 3)},
        {"positions": first.positions + 1e-4},
        {"frames": first.frames + 7},
        {"frames": first.frames - 3},
        part_of(first, slice(10, None)),
    ):
        (says,) = copies(first, copy_of(first, second, **changes))
        shift = int(changes.get("frames", first.frames)[-1] - first.frames[-1])
        later = second.camera if shift > 0 else first.camera
        assert not shift or f"{abs(shift)} frames later in {later}" in says


def test_views_of_one_scene_and_subjects_that_stand_still_are_no_copies():
    """Each detection is within a fraction of a pixel of the other camera's. Few prove nothing."""
    first, second, *others = scene(people=2).files
    assert copies(first, second, *others) == []
    still = np.repeat(first.positions[:1], len(first.frames), 0)
    rng = np.random.default_rng(0)
    near = [still + rng.normal(scale=0.1, size=still.shape) for _ in range(2)]
    assert copies(replace(first, positions=near[0]), replace(second, positions=near[1])) == []
    few = part_of(first, slice(5))
    assert copies(replace(first, **few), copy_of(first, second, **few)) == []
    assert len(copies(replace(first, **few), copy_of(first, second, **few), least=1)) == 1


def test_repeated_detections_are_found_but_for_the_first():
    """Not where one keypoint differs or is missing, or so few that chance may do it."""
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, 100, (5, 3, 6, 2))
    positions[:, :, 5] = np.nan
    positions[2, 2], positions[3, 1:] = positions[2, 0], positions[3, 0]
    expected = np.zeros((5, 3), dtype=bool)
    expected[2, 2] = expected[3, 1] = expected[3, 2] = True
    same(find_repeated(positions), expected)
    one = rng.uniform(0, 100, (6, 2))
    moved, partly, few = one.copy(), one.copy(), np.full((6, 2), np.nan)
    moved[3, 1] += 1e-3
    partly[2] = np.nan
    few[:2] = one[:2]
    assert not find_repeated(np.stack([one, moved, partly, few, few])[None]).any()
    a, b = (view(name, keypoints=PEOPLE.keypoints) for name in "ab")
    twice = replace(a, positions=a.positions.repeat(2, 1), confidence=a.confidence.repeat(2, 1))
    assert record(twice, b).seen.any(-1).sum() == record(a, b).seen.any(-1).sum()


# which frames are used


LONG = {"frames": 400, "people": 2, "cameras": 4, "seed": 2}


def test_the_sample_is_ascending_and_as_large_as_the_budget_allows():
    """A short recording is its own sample."""
    same(choose_sample_frames(recording(), SampleConfig()), np.arange(60))
    found = recording(**LONG)
    chosen = choose_sample_frames(found, SampleConfig(detections=600, least_frames=10))
    assert (np.diff(chosen) > 0).all()
    in_frame = found.seen.any(-1).sum((0, 2))
    assert len(chosen) == pytest.approx(600 / in_frame.mean(), rel=0.1)


@pytest.mark.parametrize("rare", ["pair", "place"])
def test_rare_pairs_and_places_are_chosen_and_empty_frames_are_not(rare):
    """In one frame of a hundred; that frame is in a sample of ten.

    The first camera sees somebody there alone, and half of the frames are empty; or a person, who
    otherwise stands, is in a corner of one image.
    """
    found = recording(**LONG).select(frames=np.zeros(100, dtype=int))
    positions = found.positions.copy()
    if rare == "pair":
        positions[0, np.arange(100) != 57] = np.nan
        positions[:, ::2] = np.nan
    else:
        positions[0, 57] += 300.0
    found = replace(found, positions=positions, frames=np.arange(100))
    chosen = choose_sample_frames(found, SampleConfig(detections=1, least_frames=10))
    assert len(chosen) == 10
    assert 57 in chosen
    assert rare == "place" or (chosen % 2 == 1).all()


def overcrowded() -> Recording:
    """Return a scene with 30 false detections in one frame of one camera."""
    made, rng = scene(), np.random.default_rng(0)
    files, second = list(made.files), made.files[1]
    wide, sure = np.full((60, 34, 17, 2), np.nan), np.zeros((60, 34, 17))
    instances = second.positions.shape[1]
    wide[:, :instances], sure[:, :instances] = second.positions, second.confidence
    wide[20, 4:], sure[20, 4:] = rng.uniform(0, 700, (30, 17, 2)), 0.5
    files[1] = replace(second, positions=wide, confidence=sure)
    return make_recording(files, made.rig.cameras, PEOPLE, {})


def test_an_overcrowded_frame_is_not_in_the_sample_whose_arrays_stay_small():
    found = overcrowded()
    chosen = choose_sample_frames(found, SampleConfig())
    same(chosen, np.delete(np.arange(60), 20))
    assert take_sample(found, chosen).positions.shape[2] <= 5


@pytest.mark.slow
def test_an_overcrowded_frame_is_labelled_all_the_same():
    found = calibrate_group(overcrowded())
    assert rotation_errors_deg(found.rig, scene().rig).max() < 0.15
    assert (found.matches.labels[:, 20] >= 0).sum() >= 8


def test_stretches_are_of_bounded_number_whatever_the_length():
    """Numbers that are missing are missing in them."""
    made, config = recording(), SyncConfig(window=10)
    same(choose_stretches(made, config), np.arange(60)[None])
    frames = np.arange(5000)
    long = replace(made.select(frames=frames % 60), frames=frames)
    stretches = choose_stretches(long, config)
    assert stretches.shape == (13, 30)
    assert (stretches[0, 0], stretches[-1, -1]) == (0, 4999)
    assert (np.diff(stretches, axis=1) == 1).all()
    gap = made.select(frames=np.array([0, 1, 2, 5, 6, 7]))
    same(choose_stretches(gap, SyncConfig()), [[0, 1, 2, -1, -1, 3, 4, 5]])


WIDTH, HEIGHT = 1280, 720
NAMES = ("nose", "left_wrist", "right_wrist", "left_ankle", "right_ankle")
POINTS = np.random.default_rng(3).uniform(-0.6, 0.6, (6, 2, len(NAMES), 3)) + [0.1, -0.2, 4.0]
close = np.testing.assert_allclose


def bent_camera(name, f=900.0, distortion=(-0.1, 0.02, 0.004, -0.003, 0.0)):
    matrix = [[f, 0, 631], [0, f + 8, 371], [0, 0, 1]]
    return Camera(name, (WIDTH, HEIGHT), matrix, distortion)


def seen_by(*cameras: Camera) -> Recording:
    """Return what cameras in one place see of the points."""
    positions = np.stack([pixels_from_points(each, POINTS) for each in cameras])
    frames = np.arange(10, 16)
    return Recording.from_arrays(positions, keypoints=NAMES, cameras=cameras, frames=frames)


@pytest.fixture
def filmed() -> Recording:
    return seen_by(
        bent_camera("a"), bent_camera("b", f=1000.0), bent_camera("c", distortion=np.zeros(5))
    )


def see(filmed: Recording, view, positions):
    """Return the recording in which a view sees other pixels `[frame, instance, keypoint, 2]`."""
    changed = filmed.positions.copy()
    changed[view] = positions
    return replace(filmed, positions=changed)


def test_a_reversed_axis_is_reversed_back_with_its_sides(filmed):
    """Mirrored after the detection, the sides are right."""
    order = exchanged_sides(NAMES)
    assert list(order) == [0, 2, 1, 4, 3]
    mirrored, flipped = filmed.positions[1].copy(), filmed.positions[1].copy()
    mirrored[..., 0] = WIDTH - 1 - mirrored[..., 0]
    flipped[..., 1] = HEIGHT - 1 - flipped[..., 1]
    for positions, mends in (
        (mirrored[:, :, order], (Mirrored("b"),)),
        (mirrored, (Mirrored("b"), Sides("b"))),
        (mirrored, (Mirrored("b", sides=False),)),
        (flipped, (Flipped("b"),)),
    ):
        mended = apply_mends(see(filmed, 1, positions), mends)
        close(mended.positions, filmed.positions, atol=1e-4)  # of 32 bits


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_turned_intrinsics_see_the_turned_image(filmed, degrees):
    """The camera with a lens is the first: its pixels, turned, are those of turned points."""
    pixels, size = filmed.positions[0], (WIDTH, HEIGHT)
    for _ in range(degrees // 90):
        pixels = np.stack([size[1] - 1 - pixels[..., 1], pixels[..., 0]], axis=-1)
        size = size[::-1]
    mended = Rotated("a", degrees).apply(see(filmed, 0, pixels)).cameras[0]
    assert mended.size == size
    turn = np.deg2rad(degrees)
    about_axis = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    seen = pixels_from_points(mended, POINTS @ about_axis.T)
    close(seen, pixels, atol=1e-6)


def test_resized_and_cropped_intrinsics_see_such_images(filmed):
    pixels = filmed.positions[0]
    half = Resized("a", 0.5).apply(filmed).cameras[0]
    assert half.size == (WIDTH // 2, HEIGHT // 2)
    # pixel centres are integers: the left edge of the image is at -0.5
    close(pixels_from_points(half, POINTS), (pixels + 0.5) / 2 - 0.5, atol=1e-6)
    squeezed = Resized("a", 0.64, 0.48).apply(filmed).cameras[0]
    assert squeezed.size == (round(0.64 * WIDTH), round(0.48 * HEIGHT))
    close(pixels_from_points(squeezed, POINTS), (pixels + 0.5) * (0.64, 0.48) - 0.5, atol=1e-6)
    part = Cropped("a", 100, 40).apply(filmed).cameras[0]
    close(pixels_from_points(part, POINTS), pixels - (100, 40), atol=1e-6)


def test_exchanged_cameras_and_another_focal_length(filmed):
    exchanged = Exchanged("a", "b").apply(filmed)
    assert exchanged.names == filmed.names
    assert exchanged.cameras[0].focal == filmed.cameras[1].focal
    assert Exchanged("a", "b").apply(exchanged) == filmed
    refocused = Refocused("c", focal=1000.0, sigma=4.0).apply(filmed).cameras[2]
    assert isinstance(refocused, EstimatedCamera)
    assert refocused.focal == pytest.approx(1000.0)
    assert refocused.focal_sigma == 4.0


def test_a_moved_camera_becomes_two_that_share_the_frames(filmed):
    split = apply_mends(filmed, (Moved("b", 12), Moved("b", 14)))
    assert split.names == ("a", "b", "b@12", "b@14", "c")
    sees = split.seen.any((2, 3))
    assert sees[1].tolist() == [True, True, False, False, False, False]
    assert sees[2].tolist() == [False, False, True, True, False, False]
    assert sees[3].tolist() == [False, False, False, False, True, True]
    np.testing.assert_array_equal(np.nanmax(split.positions[1:4], axis=0), filmed.positions[1])
    assert (split.confidence[1:4].sum(0) == filmed.confidence[1]).all()


def test_mends_say_how_they_are_stated(filmed):
    assert [option_of(mend) for mend in MENDS.values()] == [*MENDS]
    with pytest.raises(MismatchError, match="a, b, c"):
        Sides("d").apply(filmed)


# epochs


VIEWS = ("a", "b", "b@50", "b@70", "c", "c@50")
FRAMES = np.arange(0, 100, 2)


def test_epochs_begin_where_any_camera_was_moved():
    epochs = list_epochs(VIEWS, FRAMES)
    assert [(epoch.first, epoch.last) for epoch in epochs] == [(0, 48), (50, 68), (70, 98)]
    assert [epoch.moved for epoch in epochs] == [(), ("b", "c"), ("b",)]
    assert [epoch.views.tolist() for epoch in epochs] == [[0, 1, 4], [0, 2, 5], [0, 3, 5]]
    assert all(epoch.names == ("a", "b", "c") for epoch in epochs)
    (whole,) = list_epochs(("a", "b"), FRAMES)
    assert (whole.first, whole.last, whole.names, whole.moved) == (0, 98, ("a", "b"), ())
    assert views_by_camera(VIEWS) == {"a": [0], "b": [1, 2, 3], "c": [4, 5]}
    assert own_name("d@50", VIEWS) == "d@50"  # a camera that is called so
    assert own_name("a@b", VIEWS) == "a@b"


def test_the_rig_and_the_recording_of_an_epoch_have_each_camera_once(filmed):
    split = apply_mends(filmed, (Moved("b", 14), Moved("b", 12)))
    assert split.names == ("a", "b", "b@12", "b@14", "c")
    rig = CameraRig(split.cameras, np.tile(np.eye(3), (5, 1, 1)), np.arange(15.0).reshape(5, 3))
    parts = []
    for epoch, view in zip(list_epochs(split.names, split.frames), (1, 2, 3), strict=True):
        own = rig_of_epoch(rig, epoch)
        assert own.translation.tolist() == rig.translation[[0, view, 4]].tolist()
        parts.append(recording_of_epoch(split, epoch))
        assert parts[-1].names == own.names == ("a", "b", "c")
    together = np.concatenate([part.positions for part in parts], axis=1)
    np.testing.assert_array_equal(together, filmed.positions)


# clocks


def clock(name, kind="in step", **fields):
    return CameraClock(name, kind, **fields)


def test_own_frames_follow_the_table():
    frames = np.arange(6)
    np.testing.assert_array_equal(own_frames(clock("a", "clock", offset=-2), frames), frames - 2)
    lossy = clock("a", "dropped", table=((0, 0), (3, -1)))
    np.testing.assert_array_equal(own_frames(lossy, frames), [0, 1, 2, 2, 3, 4])
    slow = clock("a", "rate", rate=0.5, table=((0, 1),))
    expected = [1, NO_FRAME, 2, NO_FRAME, 3, NO_FRAME]
    np.testing.assert_array_equal(own_frames(slow, frames), expected)


def test_a_camera_of_five_sixths_of_the_rate_shows_each_of_its_frames_once():
    own = own_frames(clock("a", "rate", rate=5 / 6, table=((0, 0),)), np.arange(60))
    np.testing.assert_array_equal(own[own != NO_FRAME], np.arange(50))
    shown = np.flatnonzero(own != NO_FRAME)
    assert np.abs(shown * 5 / 6 - own[shown]).max() <= 0.5


def test_rates_that_are_said_are_used():
    made = recording()
    clocks = clocks_of_rates(made, {made.names[1]: 0.5})
    slow = retime(made, clocks)
    shown = clocks.source[1] >= 0
    assert shown.sum() == len(made.frames) // 2
    np.testing.assert_array_equal(clocks.numbers(made.names[1])[shown], made.frames[:30])
    assert np.isnan(slow.positions[1, ~shown]).all()
    with pytest.raises(MismatchError, match="cam99"):
        clocks_of_rates(made, {"cam99": 2.0})


def test_changes_of_changes_are_one_change():
    made = recording()
    assert retime(made, Clocks.of_one(made)) is made
    first = clocks_at(made, cam2=3)
    once = retime(made, first)
    second = clocks_at(once, cam4=-2)
    both = retime(made, second.after(first))
    assert both == retime(once, second)
    assert [each.offset for each in second.after(first).cameras] == [0, 3, 0, -2]


def test_matches_name_the_frames_of_the_files():
    made, known = recording(), truth()
    clocks = clocks_at(made, cam2=5)
    moved = retime(made, clocks)
    view = np.arange(len(made.names))[:, None]
    labels = np.where((clocks.source >= 0)[..., None], known.labels[view, clocks.source], -1)
    text = b"".join(matches_csv(moved, replace(known, labels=labels), clocks)).decode()
    for row in text.splitlines()[1:]:
        name, *numbers = row.split(",")
        frame, instance, who = map(int, numbers)
        assert known.labels[made.names.index(name), frame, instance] == who
    back = read_matches_csv(text, moved, clocks)
    np.testing.assert_array_equal(back.labels[moved.detected], labels[moved.detected])


def test_cameras_yaml_keeps_the_clocks(tmp_path):
    rig = scene().rig
    clocks = (
        clock("cam2", "clock", offset=-7),
        clock("cam3", "dropped", table=((0, 0), (50, -1))),
        clock("cam4", "rate", rate=0.5, table=((10, 2),), offset=2),
    )
    mc.write(replace(rig, clocks=clocks), tmp_path / "cameras.yaml", "mocap-calib")
    back = mc.read_rig(tmp_path / "cameras.yaml")
    assert back.clocks == clocks
    assert [each.camera for each in back.select([0, 2]).clocks] == ["cam3"]
    assert clocks_from(recording(), back.clocks).changed
    assert not clocks_from(recording(), rig.clocks).changed


MENDS = {
    "--mirrored c": Mirrored("c"),
    "--mirrored c --sides c": Mirrored("c", sides=False),
    "--flipped c": Flipped("c"),
    "--sides c": Sides("c"),
    "--rotated c:90": Rotated("c", 90),
    "--resized c:0.5": Resized("c", 0.5),
    "--resized c:1,0.75": Resized("c", 1, 0.75),
    "--crop-offset c:10,0": Cropped("c", 10.2, 0),
    "--exchanged c,d": Exchanged("c", "d"),
    "--moved c:7": Moved("c", 7),
}


def clocks_at(made: Recording, **offsets: int) -> Clocks:
    """Return clocks of cameras that are late by frames."""
    late = (clock(name, "clock", offset=offsets.get(name, 0)) for name in made.names)
    return clocks_from(made, [each if each.offset else clock(each.camera) for each in late])
