"""Synthetic animals: bodies of their skeletons, which move smoothly through the room.

Tolerances say what was measured.
"""

from dataclasses import replace

import numpy as np
import pytest
from scenes import calibrate_group, precision, rotation_errors_deg

from mocap_calib.errors import MismatchError
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.recording.joints import SHIPPED, choose_skeleton, load_skeleton
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.synthetic import Scene, simulate
from mocap_calib.synthetic.config import ANIMAL_MOTION, SimulateConfig

TWO = SimulateConfig(people=0, frames=40, cameras=3)


@pytest.fixture(scope="module", params=ANIMAL_MOTION)
def kind(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def made(kind) -> Scene:
    return simulate(replace(TWO, animals=((kind, 2),)))


def test_there_is_a_kind_for_each_shipped_model():
    assert set(SHIPPED) == {"people", *ANIMAL_MOTION}


def test_a_run_chooses_the_model_of_the_kind(kind, made):
    assert made.joints == made.detections.keypoints == load_skeleton(kind).keypoints
    assert choose_skeleton(made.detections.keypoints).name == kind


def test_bones_keep_their_lengths_and_two_animals_are_not_alike(kind, made):
    edges = np.array(load_skeleton(kind).edges)
    bones = made.poses[:, :, edges[:, 1]] - made.poses[:, :, edges[:, 0]]
    length = np.linalg.norm(bones, axis=-1)  # [frame, individual, bone]
    np.testing.assert_allclose(length, np.broadcast_to(length[:1], length.shape), rtol=1e-9)
    assert (np.abs(np.log(length[0, 0] / length[0, 1])) > 0.01).mean() > 0.5


def test_animals_move_as_much_as_animals_do(kind, made):
    """Measured from frame to frame: 0.04 of the largest extent on legs, 0.26 at tips of wings."""
    extent = np.ptp(made.poses, axis=2).max()
    step = np.linalg.norm(np.diff(made.poses, axis=0), axis=-1)
    assert 1e-3 < step.max() / extent < (0.35 if ANIMAL_MOTION[kind].beats else 0.1)
    lowest = made.poses[..., 2].min(axis=2)
    if ANIMAL_MOTION[kind].height:
        assert lowest.min() > 0
    else:
        assert np.abs(lowest).max() < 0.05 * extent


def test_most_of_an_animal_is_in_the_images(made):
    """Measured: 0.94 of the joints, and bodies of 300 to 450 pixels."""
    seen = np.isfinite(made.detections.positions[..., 0])
    assert seen.any(-1).sum() >= 2 * 3 * 40
    assert seen[made.identity >= 0].mean() > 0.8
    bodies = made.detections.positions[made.identity >= 0]  # [detection, keypoint, 2]
    extent = (np.nanmax(bodies, axis=1) - np.nanmin(bodies, axis=1)).max(-1)
    assert 80 < np.median(extent) < 700


@pytest.mark.slow
def test_birds_are_calibrated_by_their_model():
    """Measured: 0.04 degrees and every match right. A dog and rats are in the golden scenes."""
    made = simulate(SimulateConfig(people=0, animals=(("bird", 2),), frames=60))
    recording = make_recording(made.files, made.rig.cameras, load_skeleton("bird"), {})
    found = calibrate_group(take_sample(recording, slice(None)), lifter=load_lifter("bird")[0])
    assert rotation_errors_deg(found.rig, made.rig).max() < 0.5
    assert precision(found.matches.labels, made.identity) > 0.98
    assert found.matches.individuals == 2


def test_people_are_as_they_are_without_animals():
    """Who else is there changes neither them nor the rig."""
    alone = simulate(SimulateConfig(people=1, frames=5))
    mixed = simulate(SimulateConfig(people=1, animals=(("bird", 1), ("rodent", 1)), frames=5))
    assert mixed.kinds == ("people", "bird", "rodent")
    np.testing.assert_array_equal(mixed.poses[:, 0, : len(alone.joints)], alone.poses[:, 0])
    assert np.isnan(mixed.poses[:, 0, len(alone.joints) :]).all()
    np.testing.assert_array_equal(mixed.rig.translation, alone.rig.translation)


def test_the_room_is_as_large_as_its_largest_kind():
    assert SimulateConfig().ring_radius == 4.5
    assert SimulateConfig(people=0, animals=(("rodent", 1),)).ring_radius == pytest.approx(0.72)
    assert SimulateConfig(people=1, animals=(("rodent", 1),)).ring_radius == 4.5
    assert SimulateConfig(people=0, animals=(("bird", 1),), radius=3.0).ring_radius == 3.0


@pytest.mark.parametrize("changes", [{"people": 0}, {"frames": 0}, {"animals": (("fish", 1),)}])
def test_nobody_and_unknown_kinds_are_refused(changes):
    with pytest.raises(MismatchError, match=r"^simulate: expected .*, found "):
        simulate(SimulateConfig(**changes))
