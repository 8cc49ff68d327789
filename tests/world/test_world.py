"""Coordinates of results: up, floor, heading, lengths and stated worlds, on scenes with truth.

Each test places a group of true cameras and true bodies, which are in arbitrary axes and lengths,
and compares where they come out with the scene (z up, the floor at 0, metres).
"""

from dataclasses import replace

import numpy as np
import pytest
from scenes import angles_deg, calibrate_all, calibrated, moved, recording, scene, turn_matrix
from scipy.spatial.transform import Rotation

import mocap_calib as mc
from mocap_calib.config import Config, KnownCamera, Landmark, ScaleCue, WorldConfig
from mocap_calib.results import POINT_SOURCES, RigCovariance, Verdict
from mocap_calib.types import MeasuredCue, MeasuredLandmark, World
from mocap_calib.world.place import place_in_world

Z = np.array([0.0, 0.0, 1.0])
LENGTH = 2.5  # of a metre, in the unit of the groups


def group_of(
    made: mc.Scene,
    points: np.ndarray | None = None,
    *,
    noise: float = 0.0,
    rig: mc.CameraRig | None = None,
) -> mc.GroupResult:
    """Return a group of the cameras and bodies of a scene, as certain as can be.

    points: `[frame, individual, joint, 3]` of the bodies, where they are not those of the scene.
    noise: of them, metres. rig: the cameras, where they are not those of the scene.
    """
    found, rng = mc.Recording.from_keypoints(made.files, made.rig), np.random.default_rng(0)
    columns = [made.joints.index(name) for name in found.keypoints]
    points = (made.poses if points is None else points)[:, :, columns]
    points = points + noise * rng.normal(size=points.shape)
    turn, shift = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    turn *= np.linalg.det(turn)
    rig = rig or made.rig
    there = replace(rig.stand(rig.rotation @ turn.T, rig.centres @ turn.T + shift), world=World())
    there, base = there.scale(LENGTH, "arbitrary"), calibrated()
    known, frames = np.ones(points.shape[:3]), np.arange(len(points))
    quality = (known, known.astype(int), known)
    poses = mc.Poses3D(found.keypoints, frames, points @ turn.T + shift, *quality, "arbitrary")
    exact = RigCovariance(np.zeros((len(rig), 6, len(rig), 6)), LENGTH)
    return replace(
        base,
        recording=found,
        averaged=replace(base.averaged, rig=there),
        adjusted=replace(base.adjusted, rig=there),
        uncertainty=replace(base.uncertainty, covariance=exact),
        poses=poses.scale(LENGTH, "arbitrary"),
        assessment=Verdict(0.5),
    )


def unsure(group: mc.GroupResult, changes: np.ndarray) -> mc.GroupResult:
    """Return a group whose cameras may be off by changes `[change, view, 6]`."""
    known = group.uncertainty.covariance.with_changes(changes)
    return replace(group, uncertainty=replace(group.uncertainty, covariance=known))


def world_of(group: mc.GroupResult, **asked) -> World:
    return place_in_world(group, WorldConfig(**asked)).rig.world


def up_error(found: mc.GroupResult, made: mc.Scene) -> float:
    """Return by how many degrees what is said to be up is not."""
    true = found.rig.rotation[0].T @ made.rig.rotation[0] @ Z
    return float(np.degrees(np.arccos(min(true @ found.rig.world.up, 1.0))))


def floor_error(found: mc.GroupResult, made: mc.Scene) -> float:
    """Return how far the floor is from where it is, as the cameras stand over it, in metres."""
    world = found.rig.world
    height = (found.rig.centres - world.floor) @ world.up / LENGTH
    return float(np.mean(height - made.rig.centres[:, 2]))


def why_no_floor(found: mc.GroupResult) -> str:
    (why,) = (each for each in found.rig.world.remarks if each.startswith("floor not determined"))
    return why


# --- the floor


@pytest.mark.parametrize(
    ("who", "noise", "most_deg"),
    [
        ({"people": 1}, 0.02, 1.2),
        ({"people": 3}, 0.02, 1.2),
        ({"people": 0, "animals": (("quadruped", 2),)}, 0.01, 2.0),
    ],
)
def test_who_walks_shows_what_is_up_and_the_floor(who, noise, most_deg):
    """Measured without noise: 0.1 to 0.6 deg; the floor 3 cm off people's soles at most."""
    made = scene(**who)
    found = place_in_world(group_of(made, noise=noise), WorldConfig())
    assert found.rig.world.kind == "floor"
    assert up_error(found, made) < most_deg
    assert up_error(found, made) < 2.5 * np.degrees(found.rig.world.up_sigma)
    assert abs(floor_error(found, made)) < 3 * found.rig.world.floor_sigma / LENGTH
    np.testing.assert_array_equal(found.rig.world.up, Z)
    middle = np.nanmedian(found.poses.positions.reshape(-1, 3), axis=0)
    assert np.abs(middle[:2]).max() < 0.5 * LENGTH  # the origin is below the bodies, about


def test_who_stands_higher_than_others_makes_up_uncertain_then_unknown():
    """Two who stand still, 4 m apart, one on a stage; measured 3.6 and 5.3 deg for 0 and 0.3 m."""
    made, found = scene(people=2), []
    for stage in (0.0, 0.3, 0.5):
        still = np.repeat(made.poses[:1], 60, axis=0)
        still -= still.mean((0, 2), keepdims=True) * [1, 1, 0]
        still[:, 1] += np.array([4.0, 0.0, stage])
        found.append(place_in_world(group_of(made, still, noise=0.01), WorldConfig()))
    level, raised, contradicting = found
    sigma = raised.rig.world.up_sigma
    assert sigma > 1.2 * level.rig.world.up_sigma
    assert up_error(raised, made) < 1.73 * np.degrees(sigma)  # the 95 % of two directions
    assert "contradict each other" in why_no_floor(contradicting)


def test_a_climbing_animal_and_a_flying_bird_show_no_floor():
    made = scene(people=0, animals=(("quadruped", 1),))
    rise = np.linspace(0, 3, len(made.poses))[:, None, None]
    climbing = group_of(made, made.poses + Z * np.abs(np.sin(4 * rise)))
    assert "at different heights" in why_no_floor(place_in_world(climbing, WorldConfig()))
    flying = group_of(scene(people=0, animals=(("bird", 1),)))
    assert "no feet" in why_no_floor(place_in_world(flying, WorldConfig()))


def test_few_feet_make_up_uncertain_and_none_show_no_floor():
    """Measured: 2.4 deg for a stated 4.9, from feet in 8 of 60 frames."""
    made = scene(people=1)
    hidden = made.poses.copy()
    feet = [made.joints.index(f"{side}_ankle") for side in ("left", "right")]
    hidden[8:, :, feet] = np.nan
    few = place_in_world(group_of(made, hidden), WorldConfig())
    assert few.rig.world.up_sigma > 1.2 * world_of(group_of(made)).up_sigma
    assert up_error(few, made) < 1.73 * np.degrees(few.rig.world.up_sigma)
    hidden[:, :, feet] = np.nan
    for points in (hidden, np.full_like(made.poses, np.nan)):
        found = place_in_world(group_of(made, points), WorldConfig())
        assert found.rig.world.kind == "camera"
        assert why_no_floor(found)


def test_the_floor_is_below_triangulated_points_and_of_rigs_that_are_determined():
    """Interpolated points, here 5 m lower in every other frame, do not count."""
    made = scene()
    group = group_of(made)
    lower, source = group.poses.positions.copy(), group.poses.source.copy()
    lower[::2] -= 5.0
    source[::2] = POINT_SOURCES.index("interpolated")
    guessed = replace(group, poses=replace(group.poses, positions=lower, source=source))
    assert abs(floor_error(place_in_world(guessed, WorldConfig()), made)) < 0.1
    turned = np.zeros((1, 4, 6))
    turned[..., 0] = 0.1
    sigmas = [world_of(each).up_sigma for each in (group, unsure(group, turned))]
    assert sigmas[1] == pytest.approx(np.hypot(sigmas[0], 0.1))  # of the rig too
    found = place_in_world(replace(group, assessment=Verdict(20.0)), WorldConfig())
    assert "the rig is not determined" in why_no_floor(found)


# --- heading


def ahead(found: mc.GroupResult, direction: np.ndarray) -> float:
    """Return how many degrees a direction of the first camera is from y, along the floor."""
    x, y, _ = found.rig.rotation[0].T @ direction
    return float(np.degrees(np.arctan2(abs(x), y)))


@pytest.mark.parametrize("tilt", [0.0, 5.0])
def test_y_is_where_the_first_camera_looks_or_above_in_its_image_where_it_looks_down(tilt):
    """Straight down, and 5 deg beside that. Without the rule 5 deg would turn y by 90."""
    made = scene()
    found = place_in_world(group_of(made), WorldConfig())
    assert ahead(found, np.array([0.0, 0.0, 1.0])) < 2
    turn = np.radians(tilt)
    down = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])  # rows: its x, its y and where it looks
    aside = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    rotation = np.concatenate([[aside @ down], made.rig.rotation[1:]])
    above = made.rig.stand(rotation, made.rig.centres)
    found = place_in_world(group_of(made, rig=above), WorldConfig())
    assert found.rig.world.kind == "floor"
    assert ahead(found, np.array([0.0, -1.0, 0.0])) < 2


def test_y_may_point_from_one_joint_to_another():
    """Of a person who stands as in the first frame; who turns about has no such direction."""
    made = scene(people=1)
    along = np.linspace(0, 0.3, 60)[:, None, None, None] * [1, 1, 0]
    still = np.repeat(made.poses[:1], 60, axis=0) + along
    config = WorldConfig(forward="left_hip-right_hip")
    found = place_in_world(group_of(made, still), config)
    assert found.rig.world.kind == "floor"
    left, right = (found.poses.keypoints.index(f"{side}_hip") for side in ("left", "right"))
    across = np.nanmean(found.poses.positions[:, 0, right] - found.poses.positions[:, 0, left], 0)
    assert abs(across[0]) < 0.03 * across[1]
    spin = Rotation.from_rotvec(np.outer(np.linspace(0, 2 * np.pi, 60), Z)).as_matrix()
    about = np.einsum("fij,fnkj->fnki", spin, still)
    assert "in all directions" in place_in_world(group_of(made, about), config).rig.world.axes_unmet


# --- moving


def test_cameras_bodies_and_covariances_move_alike():
    """Cameras see the same points; covariances turn with the axes and scale with the unit."""
    group, rng = group_of(scene()), np.random.default_rng(0)
    spread = np.tile(np.float32([4, 1, 0, 3, 0, 2]), (*group.poses.positions.shape[:3], 1))
    draws = rng.normal(size=(50, 4, 6)) * np.arange(1, 7) * 1e-3
    group = replace(unsure(group, draws), poses=replace(group.poses, covariance=spread))
    cue = ScaleCue("camera distance", 3.0, of="cam1-cam2")
    found = place_in_world(group, WorldConfig(cues=(cue,)))
    images = (each.rig.project(each.poses.positions) for each in (found, group))
    np.testing.assert_allclose(*images, atol=1e-7)
    factor = found.uncertainty.covariance.size / group.uncertainty.covariance.size
    reach = [np.linalg.norm(np.diff(each.rig.centres, axis=0), axis=1) for each in (found, group)]
    np.testing.assert_allclose(reach[0], factor * reach[1])
    turn = found.rig.rotation[0].T @ group.rig.rotation[0]
    square = np.array([[4, 1, 0], [1, 3, 0], [0, 0, 2]])
    expected = (factor**2 * turn @ square @ turn.T)[np.triu_indices(3)]
    np.testing.assert_allclose(found.poses.covariance[0, 0, 0], expected, rtol=1e-4)
    turned = np.concatenate([draws[..., :3] @ turn.T, draws[..., 3:] @ turn.T], -1)
    matrix = found.uncertainty.covariance.matrix
    np.testing.assert_allclose(matrix, np.einsum("nvi,nwj->viwj", turned, turned), atol=1e-9)


# --- known lengths


def stature(made: mc.Scene, individual: int) -> float:
    """Return the height of the top of the head of who walks."""
    top = made.poses[:, individual, made.joints.index("head_top"), 2]
    return float(np.quantile(top, 0.75))


def thigh(made: mc.Scene) -> float:
    ends = [made.poses[0, 0, made.joints.index(f"left_{name}")] for name in ("hip", "knee")]
    return float(np.linalg.norm(ends[0] - ends[1]))


def apart(made: mc.Scene) -> float:
    return float(np.linalg.norm(made.rig.centres[0] - made.rig.centres[1]))


def scale_of(found: mc.GroupResult, made: mc.Scene) -> float:
    """Return the lengths of a result in those of the scene."""
    return float(np.linalg.norm(found.rig.centres[0] - found.rig.centres[1])) / apart(made)


def test_each_kind_of_length_gives_the_scale_and_the_surest_decides():
    """Measured: heights within 0.6 %, joints within 4, cameras exactly, the truth being known."""
    made = scene(people=2)
    cues = {
        ScaleCue("height", stature(made, 0), of="0"): 0.02,
        ScaleCue("length", thigh(made), of="left_hip-left_knee"): 0.06,
        ScaleCue("camera distance", apart(made), of="cam1-cam2"): 1e-6,
    }
    for cue, most in cues.items():
        found = place_in_world(group_of(made), WorldConfig(cues=(cue,)))
        assert found.rig.unit == found.poses.unit == "m"
        assert abs(np.log(scale_of(found, made))) < most, cue
        assert found.rig.world.scale_sigma < 0.1
    found = place_in_world(group_of(made), WorldConfig(cues=tuple(cues)))
    assert abs(np.log(scale_of(found, made))) < 0.01
    assert found.rig.world.scale_sigma < 0.002  # a distance of cameras outweighs the others
    assert len(found.rig.world.cues) == 3


def test_two_lengths_are_as_far_from_each_other_as_both_of_their_errors_say():
    """Each has the same residual: the difference over the root of the sum of both variances."""
    made = scene(people=2)
    length = ScaleCue("length", thigh(made), 0.02, of="left_hip-left_knee")
    distance = ScaleCue("camera distance", 1.1 * apart(made), 0.1 * apart(made), of="cam1-cam2")
    first, second = world_of(group_of(made), cues=(length, distance)).cues
    difference = np.log(first.measured / first.metres) - np.log(second.measured / second.metres)
    assert first.residual == pytest.approx(difference / np.hypot(first.sigma, second.sigma))
    assert second.residual == pytest.approx(-first.residual)
    assert abs(first.residual) > 0.5
    exact, rough = (
        world_of(group_of(made), cues=(replace(length, sigma=share * length.metres),))
        for share in (0.0, 0.1)
    )
    assert rough.scale_sigma == pytest.approx(np.hypot(exact.scale_sigma, 0.1))
    assert np.isnan(exact.cues[0].residual)


def test_a_distance_of_cameras_is_as_sure_as_their_centres_are_along_it():
    """Cameras that are off together tell as much as before, but for the 0.1 % of the tape."""
    made = scene()
    group = group_of(made)
    along = group.rig.centres[1] - group.rig.centres[0]
    off = np.zeros((1, 4, 6))
    cue = ScaleCue("camera distance", apart(made), of="cam1-cam2")
    for signs, share in (((1, 1), 0.0), ((0, 1), 0.02), ((-1, 1), 0.04)):
        off[0, :2, 3:] = np.outer(signs, 0.02 * along / LENGTH)
        sigma = world_of(unsure(group, off), cues=(cue,)).scale_sigma
        assert sigma == pytest.approx(np.hypot(share, 1e-3), rel=1e-3)


def test_heights_are_of_each_who_stands_and_of_nobody_who_sits():
    made = scene(people=2)
    for individual in (0, 1):
        cue = ScaleCue("height", stature(made, individual), of=f"individual_{individual}")
        found = place_in_world(group_of(made), WorldConfig(cues=(cue,)))
        assert abs(np.log(scale_of(found, made))) < 0.02
    seated, at = made.poses.copy(), made.joints.index
    for side in ("left", "right"):
        seated[:, :, at(f"{side}_ankle")] = seated[:, :, at(f"{side}_knee")] + [0.25, 0.0, 0.0]
    world = place_in_world(group_of(made, seated), WorldConfig(cues=(ScaleCue("height", 1.75),)))
    assert "straight leg" in world.rig.world.scale_unmet


def test_lengths_are_above_0():
    for metres, sigma in ((0, 0), (-1, 0), (np.nan, 0), (1, 1), (1, -0.1)):
        with pytest.raises(ValueError, match="expected metres above 0"):
            ScaleCue("height", metres, sigma)


# --- stated worlds


def known_cameras(rig: mc.CameraRig) -> tuple[KnownCamera, ...]:
    """The cameras of a rig, as a file places them."""
    return tuple(
        KnownCamera(each.name, tuple(each.rotation.ravel()), tuple(each.translation))
        for each in rig
    )


MARKS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 1]])


def landmarks(
    places: np.ndarray, stated: np.ndarray | None = None, noise: float = 0.0
) -> tuple[Landmark, ...]:
    """Points as all cameras of the scene see them. stated: where they are said to be."""
    pixels = scene().rig.project(np.array(places, float))
    pixels = pixels + noise * np.random.default_rng(0).normal(size=pixels.shape)
    stated = places if stated is None else stated
    return tuple(
        Landmark("abcde"[k], tuple(map(float, place)), name, tuple(pixels[view, k]))
        for k, place in enumerate(stated)
        for view, name in enumerate(scene().rig.names)
    )


def placed(**asked) -> mc.GroupResult:
    return place_in_world(group_of(scene()), WorldConfig(**asked))


def test_known_cameras_and_landmarks_bring_a_rig_back_to_its_world():
    true = scene().rig
    found = placed(cameras=known_cameras(true)[1:3], unit="m")
    np.testing.assert_allclose(found.rig.centres, true.centres, atol=1e-8)
    np.testing.assert_allclose(found.rig.rotation, true.rotation, atol=1e-8)
    assert (found.rig.world.kind, found.rig.unit) == ("file", "m")
    assert found.rig.world.scale_sigma < 1e-8
    found = placed(landmarks=landmarks(MARKS[:4]))
    np.testing.assert_allclose(found.rig.centres, true.centres, atol=1e-5)
    assert found.rig.world.scale_sigma < 1e-5
    assert [each.name for each in found.rig.world.landmarks] == list("abcd")
    assert max(each.distance for each in found.rig.world.landmarks) < 1e-5
    assert up_error(found, scene()) < 1.0  # the floor is found there too


def test_landmarks_measured_by_hand_are_good_enough():
    """Measured: 0.4 sigma with a pixel of noise, 1.4 with 2 cm (an axis) in 4 m, of 5."""
    wide = 4.0 * (MARKS - 0.5) * [1, 1, 0.4] + [0, 0, 1]
    by_hand = wide + 0.02 * np.random.default_rng(0).normal(size=wide.shape)
    for marks in (landmarks(MARKS, noise=1.0), landmarks(wide, by_hand, noise=1.0)):
        assert placed(landmarks=marks).rig.world.kind == "landmarks"


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        (MARKS * [1, 1, 2], "most of all e"),
        (MARKS[:, [1, 0, 2]], "right-handed axes"),
        (1000 * MARKS, "were millimetres meant"),
        (100 * MARKS, "were centimetres meant"),
        (39.4 * MARKS, "were inches meant"),
    ],
)
def test_landmarks_that_contradict_cameras_or_people_are_left_out_with_the_reason(stated, says):
    world = placed(landmarks=landmarks(MARKS, stated)).rig.world
    assert says in world.axes_unmet
    assert "\n" not in world.axes_unmet
    assert world.kind == "floor"  # as if none had been given


def test_of_four_landmarks_a_similarity_follows_seven_of_twelve_numbers():
    """8 % in a direction are 3.9 standard deviations of all, 6 of what is left; 5 are allowed."""
    stretched = MARKS[:4] * [1, 1.08, 1]
    assert placed(landmarks=landmarks(MARKS[:4], stretched)).rig.world.axes_unmet
    stretched = MARKS[:4] * [1, 1.06, 1]
    assert not placed(landmarks=landmarks(MARKS[:4], stretched)).rig.world.axes_unmet


def test_landmarks_that_make_people_small_are_doubted():
    assert len(placed(landmarks=landmarks(MARKS)).rig.world.remarks) == 2
    small = placed(landmarks=landmarks(MARKS, 0.1 * MARKS)).rig.world
    assert (small.kind, small.axes_unmet, len(small.remarks)) == ("landmarks", "", 3)


def test_files_of_cameras_are_held_to_the_rig():
    """Measured: 0.7 sigma for a calibration of 1 deg, of 5 that are allowed."""
    rig = scene().rig
    rough, made_up, one = rig.rotation.copy(), rig.rotation.copy(), rig.rotation.copy()
    for view, degrees in enumerate((1.0, -1.0, 0.5, 0.0)):
        rough[view] = turn_matrix(degrees) @ rough[view]
        made_up[view] = turn_matrix(60.0 * view) @ made_up[view]
    one[1] = turn_matrix(35.0) @ one[1]
    mirrored = rig.centres * [-1, 1, 1]
    for rotation, centres, says in (
        (rough, None, ""),
        (one, None, f"most of all {rig.names[1]}"),
        (made_up, None, "deg from there"),
        (rig.rotation, mirrored, "deg from there"),
    ):
        there = rig.stand(rotation, rig.centres if centres is None else centres)
        world = placed(cameras=known_cameras(there), unit="m").rig.world
        assert bool(world.axes_unmet) == bool(says)
        assert says in world.axes_unmet
    far = known_cameras(rig.scale(1000, "m"))
    assert "found people" in placed(cameras=far, unit="m").rig.world.axes_unmet


def test_a_known_length_scales_a_world_of_cameras_whose_unit_nobody_knows():
    target, _, _ = moved(scene().rig, np.random.default_rng(0))
    cue = ScaleCue("camera distance", 3.0, 0.0, "cam1-cam2")
    found = placed(cameras=known_cameras(target), cues=(cue,)).rig
    assert (found.unit, found.world.kind) == ("m", "file")
    assert np.linalg.norm(found.centres[1] - found.centres[0]) == pytest.approx(3.0)
    assert angles_deg(found.rotation, target.rotation).max() < 1e-5
    ratio = 3.0 / np.linalg.norm(target.centres[1] - target.centres[0])
    np.testing.assert_allclose(found.centres, ratio * target.centres, atol=1e-7)


LENGTHS = tuple(
    ScaleCue(*each)
    for each in (
        ("length", 0.4, 0, "left_hip-left_knee"),
        ("camera distance", 40.0, 0, "cam1-cam2"),
    )
)


@pytest.mark.parametrize(
    ("asked", "unmet"),
    [
        ({"axes": "floor"}, "axes"),
        ({"axes": "cam9"}, "axes"),
        ({"forward": "left_hip-right_hip"}, "axes"),
        ({"cues": (ScaleCue("height", 1.7),)}, "scale"),
        ({"cues": (ScaleCue("camera distance", 3, 0, "cam1-cam9"),)}, "scale"),
        ({"cues": LENGTHS}, "scale"),  # they contradict each other
    ],
)
def test_what_a_recording_does_not_show_is_left_out_and_said(asked, unmet):
    """Of a group without a floor."""
    group = replace(group_of(scene()), assessment=Verdict(20.0))
    found = place_in_world(group, WorldConfig(**asked)).rig
    assert (found.world.kind, found.world.camera, found.unit) == ("camera", "cam1", "arbitrary")
    assert bool(found.world.axes_unmet) == (unmet == "axes")
    assert bool(found.world.scale_unmet) == (unmet == "scale")
    np.testing.assert_allclose(found.rotation[0], np.eye(3), atol=1e-9)


ALONE = tuple(each for each in landmarks(MARKS[:4]) if each.camera == "cam1")

STRANGERS = tuple(replace(each, name=f"x{each.name}") for each in known_cameras(scene().rig))


@pytest.mark.parametrize(
    "asked",
    [
        {"axes": "flor"},
        {"forward": "nose-tail"},
        {"forward": "left_hip-right_hip", "axes": "first-camera"},
        {"cues": (ScaleCue("height", 1.7, of="anna"),)},
        {"cues": (ScaleCue("height", 175),)},
        {"cues": (ScaleCue("length", 0.4, of="left_hip"),)},
        {"cues": (ScaleCue("length", 0.4, of="left_hip-left_kne"),)},
        {"cues": (ScaleCue("height", 1.7, 0, "1"), ScaleCue("height", 1.8, 0, "individual_1"))},
        {"cues": (ScaleCue("height", 1.7),), "landmarks": landmarks(MARKS)},
        {"landmarks": (Landmark("a", (0, 0, 0), "cam9", (1, 1)),)},
        {"landmarks": landmarks(np.outer(np.arange(3), [1.0, 0, 0]))},
        {"landmarks": ALONE},
        {"cameras": STRANGERS},
    ],
)
def test_unknown_names_and_what_excludes_each_other_are_refused_before_the_work(asked):
    told, config = [], Config(world=WorldConfig(**asked))
    with pytest.raises(mc.MismatchError, match=r"^[^\n]*expected[^\n]*found[^\n]*; [^\n]*$"):
        mc.calibrate(recording(), config=config, progress=lambda *step: told.append(step))
    assert not told


# --- files


def test_files_say_what_the_coordinates_are_and_it_is_read_back(tmp_path):
    world = World("floor", up=Z, up_sigma=0.02, floor=np.zeros(3), floor_sigma=0.01)
    cues = (MeasuredCue("height", 1.75, 1.75, 0.03, 0.5),)
    marks = (MeasuredLandmark("a", 0.25),)
    world = replace(world, cues=cues, landmarks=marks, remarks=("from feet",), scale_sigma=0.03)
    rig, poses = (replace(each, world=world) for each in (scene().rig, group_of(scene()).poses))
    for thing, name, read in (
        (rig, "a.yaml", mc.read_rig),
        (rig, "a.toml", mc.read_rig),
        (poses, "a.h5", mc.read_poses),
        (poses, "a.npz", mc.read_poses),
    ):
        mc.write(thing, tmp_path / name, "anipose" if name == "a.toml" else None)
        found = read(tmp_path / name).world
        for field in ("kind", "remarks", "cues", "landmarks"):
            assert getattr(found, field) == getattr(world, field)
        np.testing.assert_array_equal([found.up, found.floor], [world.up, world.floor])
        assert [found.up_sigma, found.floor_sigma] == pytest.approx([0.02, 0.01])


def test_keypoints_with_names_of_a_users_own_are_the_joints_that_a_file_says(tmp_path):
    """Lengths and markers know them; the last name stays what it is."""
    made = scene(cameras=3, people=1, frames=30)
    joints = made.files[0].keypoints
    own = [f"q_{k}" for k in range(len(joints))]
    mc.write([replace(file, keypoints=own) for file in made.files], tmp_path / "k", format="coco")
    pairs = [f"  {name}: {joint}" for name, joint in zip(own[:-1], joints, strict=False)]
    (tmp_path / "own.yaml").write_text("\n".join(["aliases:", *pairs]))
    found = mc.read_recording(tmp_path / "k", made.rig, skeleton=tmp_path / "own.yaml")
    cue = ScaleCue("length", 0.42, of="left_hip-left_knee")
    result = calibrate_all(found, config=Config(world=WorldConfig(cues=(cue,))))
    (group,) = result.groups
    assert (group.rig.unit, group.poses.keypoints) == ("m", tuple(own))
    mc.write(result, tmp_path / "out", format="trc", fps=50)
    (table,) = (tmp_path / "out").glob("*.trc")
    markers = table.read_text().splitlines()[3].split("\t")
    assert {"LKnee", own[-1]} <= set(markers)
