"""Laws of synthetic scenes: bodies move as they can, images are projections, identities are true.

Tolerances say what was measured.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from rigs import unit
from scenes import PEOPLE

import mocap_calib as mc

FPS = 30.0
SKELETONS = {
    file.stem: yaml.safe_load(file.read_text("utf-8"))
    for file in sorted((Path(mc.__file__).parent / "skeletons").glob("*.yaml"))
}
ANIMALS = [name for name in SKELETONS if name != "people"]
FLIES = {"bird"}
CLEAN = mc.SimulateConfig(
    frames=100, noise_px=0.0, missing=0.0, outliers=0.0, false_detections=0.0, shuffle=False
)
close = np.testing.assert_allclose


def beside(vector, axis):
    """Return the part of a vector across an axis."""
    return vector - (vector * axis).sum(-1, keepdims=True) * axis


class Bodies:
    """People who move, by the names of their joints."""

    def __init__(self, seed: int, people: int = 4) -> None:
        made = mc.simulate(mc.SimulateConfig(people=people, frames=240, seed=seed))
        self.poses, self.joints = made.poses, made.joints

    def __getitem__(self, name: str) -> np.ndarray:
        return self.poses[:, :, self.joints.index(name)]

    def both(self, name: str) -> np.ndarray:
        """Return the left and the right joint, `[side, frame, individual, 3]`."""
        return np.stack([self[f"{side}_{name}"] for side in ("left", "right")])

    @property
    def ahead(self) -> np.ndarray:
        """`[frame, individual, 3]` where the pelvis faces: across its left, seen from above."""
        left, right = self.both("hip")
        return unit(np.cross((left - right) * [1, 1, 0], [0.0, 0.0, 1.0]))


@pytest.fixture(scope="module", params=[0, 1, 10])
def people(request) -> Bodies:
    return Bodies(request.param)


# people


def test_bones_keep_their_lengths_and_left_equals_right(people):
    """Bodies are human, and each is another; necks and pelvises are between left and right."""
    names = people.joints
    first, second = np.array(PEOPLE.edges).T
    lengths = np.linalg.norm(people.poses[:, :, second] - people.poses[:, :, first], axis=-1)
    close(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=1e-9)
    of = {names[b]: lengths[0, :, k] for k, (_, b) in enumerate(PEOPLE.edges)}
    for name, length in of.items():
        close(length, of[name.replace("left_", "right_")], atol=1e-9)
    assert len(np.unique(of["left_knee"].round(6))) == len(of["left_knee"])
    assert ((of["left_knee"] > 0.27) & (of["left_knee"] < 0.55)).all()
    close(people["neck"], people.both("shoulder").mean(0), atol=1e-9)
    close(people["mid_hip"], people.both("hip").mean(0), atol=1e-9)


def test_knees_bend_backward_and_elbows_of_hanging_arms_forward_only(people):
    hip, knee, ankle = map(people.both, ("hip", "knee", "ankle"))
    bend = beside(knee - hip, unit(ankle - hip))
    cosine = (unit(bend) * people.ahead).sum(-1)
    assert cosine.min() > 0.4  # measured 0.66
    shoulder, elbow, wrist = map(people.both, ("shoulder", "elbow", "wrist"))
    up = unit(people["neck"] - people["spine"])
    chest = np.cross(unit(shoulder[0] - shoulder[1]), up)
    upper = unit(elbow - shoulder)
    hanging = (upper * up).sum(-1) < -0.8
    assert hanging.any()
    forward = (beside(wrist - elbow, upper) * chest).sum(-1)
    assert forward[hanging].min() > 0.01  # metres; measured 0.02


def test_one_foot_stands_on_the_floor_where_it_is(people):
    feet = np.concatenate([people.both(name) for name in ("heel", "big_toe", "small_toe")])[..., 2]
    assert feet.min() > 0.005  # measured 0.013
    assert feet.min(0).max() < 0.035  # measured 0.021
    assert people.poses[..., 2].min() > 0
    ankles = people.both("ankle")[..., :2]
    speed = FPS * np.linalg.norm(np.diff(ankles, axis=1), axis=-1)
    assert np.percentile(speed.min(0), 90) < 0.25  # m/s, an ankle rolls over its toes; measured .13
    fastest = FPS * np.linalg.norm(np.diff(people.poses, axis=0), axis=-1).max()
    assert fastest < 10  # m/s; measured 7.7, a hand


def test_people_face_where_they_walk_with_left_on_the_left(people):
    ahead = people.ahead
    velocity = np.gradient(people["mid_hip"], 1 / FPS, axis=0) * [1, 1, 0]
    speed = np.linalg.norm(velocity, axis=-1)
    walking = speed > 0.7  # slower, hips may go back to crouch
    assert ((velocity * ahead).sum(-1)[walking] / speed[walking]).min() > 0.5
    nose = people["nose"] - people.both("ear").mean(0)
    toe = people["left_big_toe"] - people["left_heel"]
    assert all((unit(each) * ahead).sum(-1).mean() > 0.7 for each in (nose, toe))
    to_left = np.cross([0.0, 0.0, 1.0], ahead)
    for name in ("eye", "ear", "shoulder"):
        assert (np.subtract(*people.both(name)) * to_left).sum(-1).mean() > 0
    # arms swing against legs, but for gestures: measured -0.31 to -0.78 of one of four people
    leg, arm = ((np.subtract(*people.both(name)) * ahead).sum(-1).T for name in ("ankle", "wrist"))
    assert min(np.corrcoef(*each)[0, 1] for each in zip(leg, arm, strict=True)) < -0.25
    # nobody walks through others or out of the room; measured 0 m and 1.0
    place = people["mid_hip"][..., :2]
    assert np.abs(place).max() < 0.9 * 4.5 / 2 + 0.3  # hips sway beyond the path
    distance = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
    assert ((distance + 10 * np.eye(place.shape[1])).min((1, 2)) > 0.5).mean() > 0.95


@pytest.mark.parametrize(("fps", "frames"), [(7.5, 10), (25.0, 1), (120.0, 10)])
def test_people_move_at_any_frame_rate(fps, frames):
    made = mc.simulate(mc.SimulateConfig(people=2, frames=frames, fps=fps))
    assert made.poses.shape == (frames, 2, len(made.joints), 3)
    speed = fps * np.linalg.norm(np.diff(made.poses, axis=0), axis=-1)
    assert speed.max(initial=0.0) < 10


# animals


@pytest.fixture(scope="module", params=ANIMALS)
def kind(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def animals(kind) -> mc.Scene:
    config = mc.SimulateConfig(people=0, frames=40, cameras=3)
    return mc.simulate(replace(config, animals=((kind, 2),)))


def test_animals_are_bodies_of_their_skeleton_and_move_as_animals_do(kind, animals):
    """Bones keep their lengths, and two animals are not alike.

    Steps measured: 0.04 of the largest extent on legs, 0.26 at tips of wings.
    """
    joints = tuple(SKELETONS[kind]["keypoints"])
    assert animals.joints == animals.detections.keypoints == joints
    recording = mc.Recording.from_keypoints(animals.files, animals.rig.cameras)
    assert recording.model == kind
    edges = [[joints.index(name) for name in edge] for edge in SKELETONS[kind]["edges"]]
    first, second = np.array(edges).T
    length = np.linalg.norm(animals.poses[:, :, second] - animals.poses[:, :, first], axis=-1)
    close(length, np.broadcast_to(length[:1], length.shape), rtol=1e-9)
    assert (np.abs(np.log(length[0, 0] / length[0, 1])) > 0.01).mean() > 0.5
    extent = np.ptp(animals.poses, axis=2).max()
    step = np.linalg.norm(np.diff(animals.poses, axis=0), axis=-1)
    assert 1e-3 < step.max() / extent < (0.35 if kind in FLIES else 0.1)
    apart = np.linalg.norm(animals.poses[:, :, :, None] - animals.poses[:, :, None], axis=-1)
    gait = np.abs(np.diff(apart, axis=0)).max() / extent  # measured 0.034, 0.048 and 0.25
    assert gait > (0.1 if kind in FLIES else 0.028)
    lowest = animals.poses[..., 2].min(axis=2)
    if kind in FLIES:
        assert lowest.min() > 0
    else:
        assert np.abs(lowest).max() < 0.05 * extent


# cameras


@pytest.mark.parametrize("distortion", ["none", "brown", "fisheye"])
def test_cameras_look_into_the_room_through_lenses_that_do_not_fold(distortion):
    rig = mc.simulate(replace(CLEAN, frames=1, distortion=distortion)).rig
    assert rig.names == ("cam1", "cam2", "cam3", "cam4")
    offset = rig.project([0.0, 0.0, 1.0]) - np.array(rig.cameras[0].size) / 2
    assert np.abs(offset).max() < 200  # aims differ by decimetres
    assert {camera.fisheye for camera in rig.cameras} == {distortion == "fisheye"}
    close(np.linalg.det(rig.rotation), 1)
    # the image's down is the world's down, but for a roll of a few degrees
    assert (rig.rotation[:, 1, 2] < -0.7).all()
    # from the middle of the image to its corners pixels grow with the angle
    along = np.linspace(0, 0.9, 50)
    ahead = rig.centres[0] + 3 * rig.rotation[0, 2]
    across = rig.rotation[0, 0] * 16 / 9 + rig.rotation[0, 1]
    pixels = rig.project(ahead + along[:, None] * across)[0]
    assert (np.diff(np.linalg.norm(pixels - pixels[0], axis=-1)) > 0).all()


def test_cameras_are_around_the_room_or_on_an_arc():
    def widest(**changes) -> float:
        centres = mc.simulate(replace(CLEAN, frames=1, **changes)).rig.centres
        way = unit(centres[:, :2])
        return np.degrees(np.arccos(np.clip(way @ way.T, -1, 1))).max()

    assert widest(arc_deg=20.0) < 30
    assert 70 < widest(cameras=2, arc_deg=90.0) < 115
    assert widest(cameras=8) > 140


def test_the_room_is_as_large_as_its_largest_kind():
    assert mc.SimulateConfig().ring_radius == 4.5
    rodent = mc.SimulateConfig(people=0, animals=(("rodent", 1),))
    assert rodent.ring_radius == pytest.approx(0.72)
    assert replace(rodent, people=1).ring_radius == 4.5
    assert replace(rodent, radius=3.0).ring_radius == 3.0
    reach = np.linalg.norm(mc.simulate(rodent).rig.centres[:, :2], axis=1)
    close(reach, 0.72, rtol=0.25)


# detections


def true_pixels(made: mc.Scene) -> np.ndarray:
    """Return where bodies are in the images, `[view, frame, individual, keypoint, 2]`.

    NaN outside.
    """
    joints = [made.joints.index(name) for name in made.detections.keypoints]
    pixels = made.rig.project(made.poses[:, :, joints])
    size = np.array([camera.size for camera in made.rig.cameras])[:, None, None, None]
    inside = ((pixels >= -0.5) & (pixels <= size - 0.5)).all(-1, keepdims=True)
    return np.where(inside, pixels, np.nan)


def by_individual(made: mc.Scene, values: np.ndarray) -> np.ndarray:
    """Return values `[view, frame, instance, ...]` of the detections of each individual."""
    people = made.poses.shape[1]
    found = np.full((*values.shape[:2], people, *values.shape[3:]), np.nan)
    view, frame, instance = np.nonzero(made.identity >= 0)
    found[view, frame, made.identity[view, frame, instance]] = values[view, frame, instance]
    return found


@pytest.mark.parametrize("distortion", ["none", "brown", "fisheye"])
@pytest.mark.parametrize(("layout", "shuffle"), [("coco17", False), ("all", True)])
def test_without_flaws_detections_are_the_projection(distortion, layout, shuffle):
    """Of each individual who shows four joints, in an order of their own where shuffled."""
    close_by = replace(CLEAN, frames=150, radius=2.5)  # bodies reach beyond the images
    config = replace(close_by, distortion=distortion, layout=layout, shuffle=shuffle)
    made = mc.simulate(config)
    expected = true_pixels(made)
    expected[np.isfinite(expected[..., 0]).sum(-1) < 4] = np.nan
    close(by_individual(made, made.detections.positions), expected, atol=1e-9)
    assert (len({tuple(row) for row in made.identity[0]}) > 1) == shuffle or not shuffle
    for file, positions in zip(made.files, made.detections.positions, strict=True):
        np.testing.assert_array_equal(file.positions, positions)
    assert [file.camera for file in made.files] == list(made.rig.names)


def off_by(**changes) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors `[N, 2]` of the joints that are detected, and their confidence `[N]`."""
    made = mc.simulate(replace(CLEAN, **changes))
    error = by_individual(made, made.detections.positions) - true_pixels(made)
    known = np.isfinite(error[..., 0])
    return error[known], by_individual(made, made.detections.confidence)[known]


def test_flaws_are_as_large_as_asked_for_and_confidence_knows_of_them():
    """Noise, 1 % at this many joints; 5 % of outliers; and a fifth of the joints are missing."""
    error, confidence = off_by(noise_px=2.0)
    assert np.sqrt((error**2).mean()) == pytest.approx(2.0, rel=0.03)
    assert np.corrcoef(confidence, np.linalg.norm(error, axis=-1))[0, 1] < -0.2
    error, confidence = off_by(outliers=0.05)
    far = np.linalg.norm(error, axis=-1) > 10
    assert far.mean() == pytest.approx(0.05, abs=0.01)
    assert confidence[far].mean() < confidence[~far].mean() - 0.1
    whole, gaps = (len(off_by(missing=share)[0]) for share in (0.0, 0.2))
    assert gaps / whole == pytest.approx(0.8, abs=0.02)


def test_false_detections_are_of_nobody():
    wide = replace(CLEAN, frames=200, people=2, size=(4000, 3000))  # so wide that all is seen
    made = mc.simulate(replace(wide, false_detections=0.3))
    there = np.isfinite(made.detections.positions[..., 0]).any(-1)
    false = there & (made.identity < 0)
    assert false.sum(2).max() == 1
    assert 0.2 < false.any(2).mean() < 0.35  # some fall out of the image
    assert not (mc.simulate(wide).identity[..., :2] < 0).any()


def test_detections_come_first_and_have_four_joints():
    made = mc.simulate(replace(CLEAN, radius=2.5, missing=0.5, false_detections=0.5))
    seen = made.detections
    joints = np.isfinite(seen.positions[..., 0]).sum(-1)
    assert ((joints == 0) | (joints >= 4)).all()
    assert (np.diff((joints > 0).astype(int), axis=2) <= 0).all()
    assert (joints[..., -1] > 0).any()  # no instance too many
    np.testing.assert_array_equal(seen.confidence > 0, np.isfinite(seen.positions[..., 0]))
    assert (made.identity[joints == 0] == -1).all()


# scenes


def test_a_seed_is_a_scene_which_other_detectors_and_companions_do_not_change():
    config = mc.SimulateConfig(frames=20, people=2)
    first, again = mc.simulate(config), mc.simulate(config)
    assert first.detections.positions.tobytes() == again.detections.positions.tobytes()
    assert first.rig.rotation.tobytes() == again.rig.rotation.tobytes()
    other = mc.simulate(replace(config, seed=1))
    assert not np.allclose(first.poses, other.poses)
    assert not np.allclose(first.rig.rotation, other.rig.rotation)
    detected = mc.simulate(replace(config, noise_px=9.0, layout="all"))
    np.testing.assert_array_equal(first.poses, detected.poses)
    alone = mc.simulate(replace(config, people=1))
    mixed = mc.simulate(replace(config, people=1, animals=(("bird", 1), ("rodent", 1))))
    assert mixed.kinds == ("people", "bird", "rodent")
    np.testing.assert_array_equal(mixed.poses[:, 0, : len(alone.joints)], alone.poses[:, 0])
    assert np.isnan(mixed.poses[:, 0, len(alone.joints) :]).all()
    for each in (detected, mixed):
        np.testing.assert_array_equal(first.rig.translation, each.rig.translation)


@pytest.mark.parametrize("change", ["frames", "cameras", "missing", "animals"])
def test_what_cannot_be_simulated_is_refused(change):
    values = {"frames": 0, "cameras": 0, "missing": 1.5, "animals": (("fish", 1),)}
    with pytest.raises(mc.MismatchError):
        mc.simulate(mc.SimulateConfig(**{change: values[change]}))
