"""Bodies too flat to tell front from back: two views compare both readings of each."""

from dataclasses import replace

import numpy as np
from scenes import lifted, precision, recording, scene

from mocap_calib.config import Config, PairwiseConfig
from mocap_calib.geometry.rotation import angle_between, direction_angle, matrix_from_vector
from mocap_calib.pairs.affinity import body_agreement, nearest_reading, pose_error
from mocap_calib.pairs.solve import calibrate_pair
from mocap_calib.pairs.view_pair import ViewPair, are_flat, gather_view_pair
from mocap_calib.results import LiftedPoses, PairwiseCalibration
from mocap_calib.rig.associate import associate
from mocap_calib.types import Sample, silent

VIEWS, FRAMES = (0, 1), np.arange(2)


def reversed_in_depth(lifted: LiftedPoses, which: np.ndarray) -> LiftedPoses:
    """Return the bodies mirrored along their line of sight, of those `[view, frame, instance]`."""
    sight = lifted.centre / np.linalg.norm(lifted.centre, axis=-1, keepdims=True)
    depth = (lifted.body * sight[..., None, :]).sum(-1, keepdims=True)
    mirrored = lifted.body - 2 * depth * sight[..., None, :]
    return replace(lifted, body=np.where(which[..., None, None], mirrored, lifted.body))


def flat_scene(thickness: float) -> tuple[Sample, LiftedPoses]:
    """Return two frames of people pressed flat, seen exactly, and lifted exactly.

    thickness: what is left of it. The network states a spread of 0.1 body sizes.
    """
    made, seen = scene(), recording().select(frames=FRAMES)
    poses = made.poses[FRAMES]
    middle = poses.mean(-2, keepdims=True)
    _, _, axes = np.linalg.svd(poses - middle, full_matrices=False)
    across = ((poses - middle) @ axes[..., 2, :, None]) * axes[..., None, 2, :]
    poses = poses - (1 - thickness) * across
    who = made.identity[:, FRAMES]
    turn, shift = (x[:, None, None] for x in (made.rig.rotation, made.rig.translation))
    inside = [poses[np.arange(len(FRAMES))[:, None], of_view] for of_view in who]
    inside = np.stack(inside) @ np.swapaxes(turn, -1, -2) + shift[..., None, :]
    inside[who < 0] = np.nan
    centre = inside.mean(-2)
    body = inside - centre[..., None, :]
    size = np.sqrt((body**2).sum(-1).mean(-1))
    rays = inside[..., seen.vocabulary, :]
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    bodies = LiftedPoses(
        body=body / size[..., None, None],
        centre=centre / size[..., None],
        spread=np.where(np.isfinite(body[..., 0]), 0.1, np.nan),
    )
    sample = replace(
        seen,
        rays=rays,
        positions=rays[..., :2],
        confidence=np.isfinite(rays[..., 0]).astype(float),
    )
    return sample, bodies


def gather(sample: Sample, bodies: LiftedPoses, config: PairwiseConfig) -> ViewPair:
    """Return the pair of the two views."""
    return gather_view_pair(sample, bodies, VIEWS, config=config, rng=np.random.default_rng(0))


def test_only_flat_bodies_may_be_reversed():
    """A reversal moves people by 0.3 body sizes; the network is sure of them to 0.1."""
    assert not are_flat(recording(), lifted(), VIEWS, np.arange(60))
    assert not are_flat(*flat_scene(1.0), VIEWS, FRAMES)
    sample, bodies = flat_scene(0.1)
    assert are_flat(sample, bodies, VIEWS, FRAMES)
    sure = replace(bodies, spread=bodies.spread / 20)
    assert not are_flat(sample, sure, VIEWS, FRAMES)
    none = LiftedPoses(*(np.full_like(x, np.nan) for x in vars(bodies).values()))
    assert not are_flat(sample, none, VIEWS, FRAMES)


def test_the_nearest_reading_counts():
    sample, bodies = flat_scene(0.1)
    pair = gather(sample, bodies, PairwiseConfig())
    assert len(pair.cross) == 4
    rotation = matrix_from_vector(np.array([[0.3, -1.0, 0.2], [0.1, 0.5, 0.0]]))
    translation = np.array([[1.0, 1.0, 1.0], [1.0, 2.0, 3.0]])
    of_readings = []
    for of_a in (False, True):
        for of_b in (False, True):
            which = np.zeros(bodies.centre.shape[:3], dtype=bool)
            which[0], which[1] = of_a, of_b
            mirrored = gather(sample, reversed_in_depth(bodies, which), PairwiseConfig())
            of_readings.append(replace(mirrored, cross=mirrored.cross[:1]))
    every = np.arange(pair.lifted.size)
    errors = [pose_error(one, rotation, every, PairwiseConfig()) for one in of_readings]
    found = pose_error(pair, rotation, every, PairwiseConfig())
    np.testing.assert_allclose(found, np.min(errors, 0), atol=1e-9)
    agreements = [
        body_agreement(one, rotation, translation, PairwiseConfig()) for one in of_readings
    ]
    np.testing.assert_allclose(
        body_agreement(pair, rotation, translation, PairwiseConfig()),
        np.max(agreements, 0),
        atol=1e-9,
    )
    matched = pair.lifted > 0
    crosses = [one.cross[0][matched] for one in of_readings]
    traces = [np.einsum("ij,nji->n", rotation[0], cross) for cross in crosses]
    nearest = np.stack(crosses)[np.argmax(traces, 0), np.arange(matched.sum())]
    np.testing.assert_allclose(nearest_reading(pair, rotation[0], matched), nearest, atol=1e-12)


def half_reversed(bodies: LiftedPoses) -> LiftedPoses:
    """Return the bodies with half of them reversed, at random."""
    wrong = np.random.default_rng(3).random(bodies.centre.shape[:3]) < 0.5
    return reversed_in_depth(bodies, wrong)


def solve(
    sample: Sample, bodies: LiftedPoses, config: PairwiseConfig
) -> tuple[PairwiseCalibration, float, float]:
    """Return the answer for the two views, and its E_R and E_t in degrees."""
    found = calibrate_pair(gather(sample, bodies, config), config)
    assert found is not None
    rotation, translation = scene().rig.relative(*VIEWS)
    turned = np.degrees(angle_between(found.rotation, rotation))
    return found, float(turned), float(np.degrees(direction_angle(found.translation, translation)))


def test_flat_bodies_lifted_the_wrong_way_round_give_the_right_pose():
    """Without both readings 43 degrees off, score 0.30."""
    sample, bodies = flat_scene(0.1)
    found, turned, shifted = solve(sample, half_reversed(bodies), PairwiseConfig())
    assert max(turned, shifted) < 0.01
    assert found.score > 0.99


def test_flat_bodies_do_not_speak_against_who_is_who():
    """All are matched; by the reversed bodies as they are, 4 of 24 detections are left out."""
    sample, bodies = flat_scene(0.1)
    labels = associate(sample, half_reversed(bodies), scene().rig, Config(), progress=silent).labels
    who = scene().identity[:, FRAMES]
    assert precision(labels, who) == 1
    assert ((labels >= 0) == (who >= 0)).all()
