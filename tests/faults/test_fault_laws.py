"""Evidence for faults of a camera, and when a camera was moved: closed forms and known scenes."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import angles_deg, calibrated, recording, scene, turn_camera

import mocap_calib as mc
from mocap_calib.adjust.camera_fit import CameraFit, pose_of
from mocap_calib.adjust.resection import Sightings, sightings_of
from mocap_calib.config import DECISIVE_NATS, DiagnosisConfig, MovedConfig
from mocap_calib.faults import hypotheses, moved
from mocap_calib.faults.mend import Correction, find_exchanged_cameras, find_rivals
from mocap_calib.geometry.rotation import quarter_turn

DIAGNOSIS, CONFIG = DiagnosisConfig(), MovedConfig()
FRAMES = 120
LEAST = 1e-4  # focal lengths: noise


# --- evidence for a fault of all frames


def test_evidence_is_the_ratio_of_the_densities_of_the_estimate():
    """Of one unknown, in closed form; of an estimate far more uncertain than both priors, none."""
    sound, faulty, value, sigma = 0.02, 0.4, 0.1, 0.01
    narrow, wide = sound**2 + sigma**2, faulty**2 + sigma**2
    expected = (value**2 / narrow - value**2 / wide + np.log(narrow / wide)) / 2
    priors = np.array([sound]), np.array([faulty])
    found = hypotheses.log_bayes_factor(np.array([value]), np.array([[sigma**2]]), *priors)
    assert found == pytest.approx(expected)
    vague = hypotheses.log_bayes_factor(np.array([3.0]), np.array([[100.0**2]]), *priors)
    assert vague == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(
    ("evidence", "cameras", "rivals"),
    [
        ((9.0,), "a", ""),
        ((9.0, 9.0 - 2 * DECISIVE_NATS), "ab", ""),
        ((9.0, 9.0 - DECISIVE_NATS / 2, 30.0), "abc", "bc"),
        ((9.0, 30.0), "aa", ""),  # two faults of one camera, the likelier first
    ],
)
def test_rivals_are_cameras_of_which_a_change_explains_as_much(evidence, cameras, rivals):
    tried = [
        Correction((mc.Fault(camera, "focal", "", {"nats": nats}),), calibrated(), nats)
        for nats, camera in zip(evidence, cameras, strict=True)
    ]
    assert find_rivals(tried) == set(rivals)


@pytest.mark.parametrize(
    ("x", "y", "evident"),
    [
        (-0.2, -0.15, True),
        (-0.02, 0.0, False),  # as of sound intrinsics
        (0.2, 0.0, False),  # to the right
        (-0.8, 0.0, False),  # what is seen reaches beyond what would be left
    ],
)
def test_a_crop_moves_what_is_seen_to_the_left_and_up_and_hides_the_rest(x, y, evident):
    given = recording(people=1, false_detections=0.0)
    size = np.array(given.cameras[1].size)
    shifted = given.positions.copy()
    shifted[1] += np.array([-0.2, -0.15]) * size
    found = hypotheses.list_hypotheses(replace(given, positions=shifted), 1)
    (cropped,) = (each for each in found if each.name == "cropped")
    unknowns = np.array([x, y]) * size
    fit = CameraFit(np.eye(3, 4), unknowns, np.diag([100.0, 100.0]), np.ones(1000))
    nats = hypotheses.evidence_of_unknowns(cropped, fit, DIAGNOSIS)
    assert nats > 3 * DECISIVE_NATS if evident else nats < 0
    mend = hypotheses.mend_of(cropped, fit)
    assert mend == mc.Cropped(given.names[1], *np.round(-unknowns).tolist(), sigma=10.0)


def test_hypotheses_have_names_and_descriptions_of_their_own():
    found = hypotheses.list_hypotheses(recording(people=1, false_detections=0.0), 1)
    assert found[0].name == "given"
    assert len({each.name for each in found}) == len(found)
    said = [hypotheses.describe(each.mend) for each in found if each.mend is not None]
    assert len(set(said)) == len(said) > 4


def test_a_camera_on_its_side_is_seen_beside_upright_ones():
    rotation = scene().rig.rotation
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    others = np.delete(rotation, 1, axis=0)
    # images turned clockwise: what is down lies to the left
    assert quarter_turn(turn @ rotation[1], others, 30) == 90
    assert quarter_turn(turn @ turn @ rotation[1], others, 30) == 180
    assert quarter_turn(rotation[1], others, 30) == 0
    others[0] = turn @ others[0]
    assert quarter_turn(turn @ rotation[1], others, 30) == 0


@pytest.mark.parametrize(
    ("focal", "change", "pairs"),
    [
        ((766, 688, 724), (-0.107, 0.099, -0.005), 1),
        ((766, 688, 724), (0.0, 0.099, 0.0), 0),  # one of the two is right
        ((700, 700, 700), (-0.107, 0.099, -0.005), 0),
        ((766, 688), (-0.107, 0.099), 0),  # no third camera
    ],
)
def test_cameras_that_want_the_focal_lengths_of_each_other_may_be_exchanged(focal, change, pairs):
    group, sigma = calibrated(cameras=len(focal), people=1, frames=30), np.full(len(focal), 0.007)
    cameras = [
        replace(each, matrix=np.diag([f, f, 1.0]))
        for each, f in zip(group.rig.cameras, focal, strict=True)
    ]
    known = replace(group.uncertainty, focal_change=np.array(change), focal_sigma=sigma)
    adjusted = replace(group.adjusted, rig=replace(group.rig, cameras=tuple(cameras)))
    found = find_exchanged_cameras(replace(group, adjusted=adjusted, uncertainty=known))
    assert len(found) == pairs
    for each in found:
        assert [fault.mend for fault in each.faults] == [mc.Exchanged("cam1", "cam2")] * 2


# --- when a camera was moved


def rays_of(
    pose: np.ndarray, bodies: np.ndarray, rng: np.random.Generator, scale: float, noise: float
) -> np.ndarray:
    """What a camera sees of bodies `[frame, body, joint, 3]`, with noise, in any order."""
    seen = bodies @ pose[:, :3].T + pose[:, 3]
    seen[..., :2] *= scale
    rays = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
    rays += noise * rng.normal(size=rays.shape)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    order = rng.permuted(np.tile(np.arange(bodies.shape[1]), (len(bodies), 1)), axis=1)
    return np.take_along_axis(rays, order[..., None, None], axis=1)


def sightings(
    poses: list[np.ndarray], starts: tuple[int, ...] = (), *, scale=1.0, noise=0.003
) -> Sightings:
    """What a camera saw of two people that had these poses, the later ones from these frames on.

    scale: of angles from the axis, as a wrong focal length has it. noise: radians.
    """
    bodies = scene(frames=FRAMES, people=2).poses
    bodies = bodies[:, :, np.isfinite(bodies).all((0, 1, 3))]
    rng, parts = np.random.default_rng(0), np.split(bodies, starts)
    rays = [rays_of(*each, rng, scale, noise) for each in zip(poses, parts, strict=True)]
    return sightings_of(np.concatenate(rays), bodies)


def pose_before() -> np.ndarray:
    return pose_of(scene(frames=FRAMES, people=2).rig, 1)


def pose_after(degrees: float, metres: float) -> np.ndarray:
    rig = scene(frames=FRAMES, people=2).rig
    aside = metres * rig.rotation[1, 0]
    return pose_of(turn_camera(rig, 1, degrees, shift=aside), 1)


@pytest.mark.parametrize(
    ("degrees", "metres"),
    [(2.0, 0.0), (10.0, 0.0), (40.0, 0.0), (0.0, 0.5)],
)
def test_a_change_is_found_to_the_frame_with_both_poses(degrees, metres):
    """Measured: exact frames, poses to 0.1 deg of noise of 0.17 deg."""
    poses = [pose_before(), pose_after(degrees, metres)]
    seen = sightings(poses, (71,))
    epochs, evidence = moved.find_epochs(poses[0], seen, CONFIG, LEAST)
    assert len(epochs.poses) == 2
    assert evidence > 2 * DECISIVE_NATS
    assert moved.last_moments(epochs.poses, seen, epochs.tolerance) == (70, 71)
    for found, true in zip(epochs.poses, poses, strict=True):
        assert angles_deg(found[:, :3], true[:, :3]) < 0.5


def test_two_changes_are_found_and_the_way_back_counts():
    seen = sightings([pose_before(), pose_after(5.0, 0.0), pose_before()], (40, 90))
    epochs, _ = moved.find_epochs(pose_before(), seen, CONFIG, LEAST)
    assert epochs.bounds[1:-1].tolist() == [2 * 40, 2 * 90]  # two people a frame


@pytest.mark.parametrize("scale", [1.0, 1.03, 0.9])
def test_errors_that_drift_with_the_subject_are_no_change(scale):
    """A wrong focal length makes errors that follow where people walk."""
    seen = sightings([pose_before()], scale=scale)
    epochs, evidence = moved.find_epochs(pose_before(), seen, CONFIG, LEAST)
    assert (evidence, len(epochs.poses)) == (0, 1)


def test_errors_that_are_alike_at_all_times_do_not_stand_out():
    """Noise of 3 degrees: detections cost 0.65 of an outlier, before and after any moment."""
    seen = sightings([pose_before()], noise=0.06)
    found = moved.segment(pose_before(), seen, CONFIG, LEAST)
    assert moved.choose_number(*moved.total_costs(found, seen), CONFIG)[1] == 0


@pytest.mark.parametrize(
    ("costs", "changes", "evidence"),
    [
        ([100.0, 99.9], 0, 0.0),
        ([100.0, 40.0], 1, 750.0 - 3.2),
        ([100.0, 40.0, 39.9], 1, 750.0 / 2.506 - 3.2),
        ([100.0, 60.0, 40.0, 39.99], 2, 250.0 - 3.2),
        ([100.0, 80.0, 64.0, 51.0, 41.0], 0, 0.0),
    ],
)
def test_as_many_epochs_are_accepted_as_there_is_evidence_for(costs, changes, evidence):
    """Of 1000 detections; the last drift: each change gains as much as the one before.

    log 25 = 3.2 nats are for the moment: an epoch has at least 4 % of the detections.
    """
    found, nats = moved.choose_number(np.array(costs), 1000, CONFIG)
    assert (found, nats) == (changes, pytest.approx(evidence, rel=1e-2))
