"""Cameras on one clock: by name, by number, by meaning; and what does not belong together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.io.cameras.read import read_cameras
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.recording.joints import edges_of_keypoints, load_skeleton, match_names
from mocap_calib.recording.names import match_cameras, views_with_detections
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import find_repeated, make_recording
from mocap_calib.types import Camera, Keypoints2D, Skeleton

PEOPLE = load_skeleton("people")

SHARED = Path(__file__).parents[3] / "shared"
SKELETON = Skeleton(
    "test", ("nose", "neck", "left_ear", "right_ear"), (), (), {"thorax": "neck", "sternum": "neck"}
)


def camera(name, size=(640, 480)):
    return Camera(
        name,
        size,
        np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        np.array([-0.1, 0.01, 0, 0, 0]),
        False,
    )


def view(name, frames=(0, 1, 2), keypoints=("nose", "neck"), instances=1, seed=0, size=(640, 480)):
    rng = np.random.default_rng([seed, *name.encode()])
    positions = rng.uniform(100, 400, (len(frames), instances, len(keypoints), 2)).astype(
        np.float32
    )
    confidence = rng.uniform(0.2, 1.0, positions.shape[:3])
    return Keypoints2D(
        name, tuple(keypoints), np.array(frames), positions, confidence, False, size, f"{name}.json"
    )


def record(*views, cameras=None, aliases=None):
    return take_sample(
        make_recording(
            views, cameras or [camera(v.camera) for v in views], SKELETON, aliases or {}
        ),
        slice(None),
    )


def refused(*args, **kwargs):
    with pytest.raises(MismatchError) as caught:
        record(*args, **kwargs)
    message = str(caught.value)
    assert "expected" in message
    assert "found" in message
    assert "\n" not in message
    return message


# --- laws


@settings(max_examples=20, deadline=None)
@given(st.permutations(range(3)), st.integers(0, 100))
def test_the_order_of_files_does_not_matter(order, seed):
    views = [view("abc"[k], instances=k + 1, seed=seed) for k in range(3)]
    cameras = [camera(name) for name in "abc"]
    first, second = (
        record(*views, cameras=cameras),
        record(*(views[k] for k in order), cameras=cameras),
    )
    assert first.names == second.names
    for name in ("frames", "positions", "confidence", "rays", "tracked", "vocabulary"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


@settings(max_examples=20, deadline=None)
@given(st.permutations(range(3)))
def test_the_order_of_cameras_is_the_order_of_views(order):
    views = [view(name) for name in "abc"]
    first, second = record(*views), record(*views, cameras=[camera("abc"[k]) for k in order])
    assert second.names == tuple("abc"[k] for k in order)
    np.testing.assert_array_equal(second.rays, first.rays[list(order)])


@settings(max_examples=20, deadline=None)
@given(st.permutations(range(3)))
def test_the_order_of_keypoints_in_one_file_does_not_matter(order):
    names = ("nose", "neck", "whisker")
    a, b = view("a", keypoints=names), view("b", keypoints=names)
    turned = replace(
        b,
        keypoints=tuple(names[k] for k in order),
        positions=b.positions[:, :, order],
        confidence=b.confidence[:, :, order],
    )
    first, second = record(a, b), record(a, turned)
    assert first.keypoints == second.keypoints == names
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.confidence, second.confidence)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.sets(st.integers(0, 30), min_size=1), min_size=2, max_size=4))
def test_frames_are_those_of_two_views_by_number(sets):
    views = [view("abcd"[k], frames=sorted(frames)) for k, frames in enumerate(sets)]
    shared = sorted(n for n in range(31) if sum(n in frames for frames in sets) >= 2)
    if not shared:
        refused(*views)
        return
    recording = record(*views)
    assert recording.frames.tolist() == shared
    for v, one in enumerate(views):
        for row, number in enumerate(shared):
            if number in sets[v]:
                np.testing.assert_array_equal(
                    recording.positions[v, row], one.positions[one.frames.tolist().index(number)]
                )
            else:
                assert not recording.seen[v, row].any()


def test_rays_project_back_to_the_positions():
    recording = record(view("a"), view("b"))
    for v, one in enumerate(recording.cameras):
        # measured 1e-12 px at this mild distortion, which cv2 inverts by iteration
        np.testing.assert_allclose(
            pixels_from_points(one, recording.rays[v]), recording.positions[v], atol=1e-9
        )


def test_what_the_lens_model_cannot_undo_is_no_detection():
    a, b = view("a"), view("b")
    a.positions[1, 0, 1] = [900, 240]
    bent = [replace(camera(name), distortion=np.array([-0.3, 0, 0, 0])) for name in "ab"]
    recording = record(a, b, cameras=bent)
    gone = np.zeros(recording.seen.shape, dtype=bool)
    gone[0, 1, 0, 1] = True
    np.testing.assert_array_equal(recording.seen, ~gone)
    np.testing.assert_array_equal(recording.confidence == 0, gone)
    np.testing.assert_array_equal(np.isnan(recording.rays).all(-1), gone)


def test_missing_stays_missing_and_instances_are_padded():
    a, b = view("a", instances=3), view("b")
    a.positions[1, 0, 1] = np.nan
    a.confidence[1, 0, 1] = 0
    recording = record(a, b)
    assert recording.positions.shape == (2, 3, 3, 2, 2)
    np.testing.assert_array_equal(recording.seen[0], np.isfinite(a.positions[..., 0]))
    np.testing.assert_array_equal(recording.seen[1, :, 1:], False)
    np.testing.assert_array_equal(recording.confidence > 0, recording.seen)
    np.testing.assert_array_equal(np.isfinite(recording.rays).all(-1), recording.seen)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 9), min_size=1, max_size=10, unique=True))
def test_slicing_frames(index):
    recording = record(view("a", frames=range(10)), view("b", frames=range(10)))
    index = np.array(sorted(index))
    part = recording.select(frames=index)
    np.testing.assert_array_equal(part.frames, recording.frames[index])
    np.testing.assert_array_equal(part.rays, recording.rays[:, index])
    mask = np.isin(np.arange(10), index)
    np.testing.assert_array_equal(recording.select(frames=mask).positions, part.positions)


# --- names of keypoints


def test_names_of_one_joint_are_one_keypoint():
    recording = record(
        view("a", keypoints=("thorax", "LEar")), view("b", keypoints=("left ear", "neck"))
    )
    assert recording.keypoints == ("thorax", "LEar")
    assert recording.vocabulary.tolist() == [1, 2]
    assert recording.seen.all()


def test_names_beyond_the_vocabulary_are_matched_as_they_are_spelled():
    recording = record(
        view("a", keypoints=("TailTip", "nose")), view("b", keypoints=("nose", "tail_tip"))
    )
    assert recording.keypoints == ("TailTip", "nose")
    assert recording.vocabulary.tolist() == [-1, 0]


def test_keypoints_of_one_view_only_are_left_out():
    recording = record(
        view("a", keypoints=("nose", "neck", "x")), view("b", keypoints=("y", "nose", "neck"))
    )
    assert recording.keypoints == ("nose", "neck")


def test_a_joint_and_its_alias_side_by_side_stay_apart():
    views = [
        view("a", keypoints=("neck", "thorax")),
        view("b", keypoints=("thorax", "neck")),
        view("c", keypoints=("thorax",)),
    ]
    recording = record(*views)
    assert recording.keypoints == ("neck", "thorax")
    assert recording.vocabulary.tolist() == [1, -1]
    np.testing.assert_array_equal(recording.positions[2, :, :, 1], views[2].positions[:, :, 0])
    assert not recording.seen[2, :, :, 0].any()


def test_names_that_mean_the_same_stay_apart():
    recording = record(
        view("a", keypoints=("LEar", "left_ear", "nose")),
        view("b", keypoints=("LEar", "left_ear", "nose")),
    )
    assert recording.keypoints == ("LEar", "left_ear", "nose")
    assert sorted(recording.vocabulary.tolist()) == [-1, 0, 2]


def test_own_aliases_come_first():
    recording = record(
        view("a", keypoints=("Gola", "nose")),
        view("b", keypoints=("neck", "nose")),
        aliases={"gola": "neck"},
    )
    assert recording.keypoints == ("Gola", "nose")
    assert recording.vocabulary.tolist() == [1, 0]


# --- confidence


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_confidence_up_to_1_is_kept(scale):
    views = [replace(v, confidence=v.confidence * scale) for v in (view("a"), view("b"))]
    np.testing.assert_array_equal(
        record(*views).confidence, np.stack([v.confidence for v in views]).astype(np.float32)
    )


def test_confidence_beyond_1_is_scaled_by_view():
    a, b = view("a", frames=range(200)), view("b", frames=range(200))
    recording = record(replace(a, confidence=a.confidence * 6), b)
    np.testing.assert_array_equal(recording.confidence[1], b.confidence.astype(np.float32))
    assert recording.confidence[0].max() == 1.0
    np.testing.assert_allclose(
        recording.confidence[0],
        (a.confidence / np.percentile(a.confidence, 99)).clip(max=1),
        rtol=1e-6,
    )


# --- what does not belong together


def test_cameras_are_matched_by_name_and_extra_ones_dropped():
    views = [view("Left"), view("right")]
    cameras = [camera("top"), camera("RIGHT"), camera("Left"), camera("left")]
    assert match_cameras(views, cameras) == ("Left", "RIGHT")
    assert record(*views, cameras=cameras).names == ("RIGHT", "Left")


def test_keypoints_without_a_camera_are_refused():
    message = refused(view("a"), view("b"), cameras=[camera("a"), camera("c")])
    assert "a, b" in message
    assert "a, c" in message
    assert "LEFT.json" in refused(view("left"), view("LEFT"), cameras=[camera("left")])


def test_an_ambiguous_case_is_refused():
    refused(view("CAM"), view("b"), cameras=[camera("cam"), camera("Cam"), camera("b")])


def test_one_camera_is_too_few():
    assert "two cameras" in refused(view("a"))


def test_a_view_without_detections_is_dropped_and_two_must_remain():
    empty = replace(
        view("c"), positions=np.full((3, 1, 2, 2), np.nan), confidence=np.zeros((3, 1, 2))
    )
    none = replace(view("d"), positions=np.zeros((3, 0, 2, 2)), confidence=np.zeros((3, 0, 2)))
    recording = record(view("a"), empty, none, view("b"))
    assert recording.names == ("a", "b")
    assert [v.camera for v in views_with_detections([view("a"), empty, none])] == ["a"]
    refused(view("a"), empty)


def test_frames_that_do_not_overlap_are_refused_with_their_ranges():
    message = refused(view("a", frames=(0, 1)), view("b", frames=(100, 104)))
    assert "a 0-1" in message
    assert "b 100-104" in message


def test_detections_that_are_never_at_once_are_refused():
    a, b = view("a"), view("b")
    a.positions[1:], b.positions[:1] = np.nan, np.nan
    assert "co-visible" in refused(a, b)


def test_no_common_keypoint_is_refused_with_the_names():
    message = refused(view("a", keypoints=("x", "y")), view("b", keypoints=("u", "v")))
    assert "x, y" in message
    assert "u, v" in message


def test_another_image_size_is_refused():
    message = refused(view("a", size=(1280, 960)), view("b"))
    assert "1280 x 960" in message
    assert "640 x 480" in message


def test_positions_far_outside_the_image_are_refused_but_a_wild_point_is_not():
    a, b = view("a", size=(0, 0), frames=range(200)), view("b", frames=range(200))
    far = replace(a, positions=a.positions * 3)
    assert "640 x 480" in refused(far, b)
    a.positions[0, 0, 0] = 5000
    assert record(a, b).names == ("a", "b")


def test_normalised_positions_are_refused():
    a = view("a", size=(0, 0))
    assert "pixels" in refused(replace(a, positions=a.positions / 640), view("b"))


def test_an_unknown_size_is_taken_from_the_keypoints():
    recording = record(
        view("a"), view("b", size=(0, 0)), cameras=[camera("a", (0, 0)), camera("b", (0, 0))]
    )
    assert [c.size for c in recording.cameras] == [(640, 480), (0, 0)]


def test_two_files_without_a_source_are_two_files():
    recording = record(*(replace(view(name), source="") for name in "ab"))
    assert recording.names == ("a", "b")


@pytest.mark.skipif(not SHARED.is_dir(), reason="no ../shared here")
@pytest.mark.parametrize("folder", sorted(SHARED.glob("recordings/*")), ids=lambda path: path.name)
def test_real_recordings_are_recordings(folder):
    views = read_keypoints([folder / "keypoints"])
    recording = make_recording(
        views, read_cameras(folder / "intrinsics.toml"), load_skeleton("people"), {}
    )
    assert len(recording.cameras) == len(views)
    assert recording.keypoints == views[0].keypoints
    order = [[v.camera for v in views].index(name) for name in recording.names]
    for v, k in enumerate(order):
        kept = recording.seen[v, :, : views[k].positions.shape[1]]
        np.testing.assert_array_equal(
            recording.positions[v, :, : views[k].positions.shape[1]][kept],
            views[k].positions[kept].astype(np.float32),
        )
        there = (
            np.isfinite(views[k].positions[..., 0]) & ~find_repeated(views[k].positions)[..., None]
        )
        # measured 1.06 %: noise beyond the fold of one lens near the corners, which has no ray
        assert kept.sum() >= 0.98 * there.sum()


def named_edges(names: tuple[str, ...]) -> set[frozenset[str]]:
    """The edges between keypoints of these names."""
    edges = edges_of_keypoints(PEOPLE, match_names(names, PEOPLE))
    return {frozenset((names[a], names[b])) for a, b in edges}


def test_edges_join_the_keypoints_that_there_are():
    assert len(named_edges(PEOPLE.keypoints)) == len(PEOPLE.keypoints) - 1
    assert named_edges(("spine", "left_wrist", "left_shoulder", "something")) == {
        frozenset(("spine", "left_shoulder")),  # over the neck
        frozenset(("left_shoulder", "left_wrist")),  # over the elbow
    }
    nobody = edges_of_keypoints(PEOPLE, np.array([-1, -1]))
    assert nobody == ()


def test_edges_close_a_trunk_without_neck_and_pelvis():
    """COCO's keypoints: shoulders and hips make a rectangle."""
    edges = named_edges(PEOPLE.keypoints[:17])
    trunk = [("left_shoulder", "right_shoulder"), ("left_hip", "right_hip")]
    trunk += [(f"{side}_shoulder", f"{side}_hip") for side in ("left", "right")]
    assert {frozenset(pair) for pair in trunk} <= edges


# --- names of files and cameras


@pytest.mark.parametrize(
    ("paths", "remedy"),
    [
        (
            ("s/rat3_cam1_2024.json", "s/rat3_cam10_2024.json"),
            r"use camera_regex='cam10|cam1|c\\.2', which finds these names in the paths",
        ),
        (
            ("s/left.json", "s/cam1.json"),
            "give files with their cameras, as cam10=s/left.json, or use camera_regex= to find "
            "the camera names in the paths, or rename one side",
        ),
        (
            ("cam1/left.json", "cam1/right.json"),
            "give files with their cameras, as cam1=cam1/left.json, or use camera_regex= to find "
            "the camera names in the paths, or rename one side",
        ),
    ],
)
def test_names_that_differ_are_told_with_the_option_that_joins_them(paths, remedy):
    known = [camera(name) for name in ("cam1", "cam10", "c.2")]
    views = [replace(view(Path(path).stem), source=path) for path in paths]
    with pytest.raises(MismatchError) as refused:
        match_cameras(views, known)
    found = ", ".join(each.camera for each in views)
    assert str(refused.value) == (
        "expected a camera of the same name for each keypoint file, "
        f"found keypoints of {found} and cameras cam1, cam10, c.2; {remedy}"
    )
