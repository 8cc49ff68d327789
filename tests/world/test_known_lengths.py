"""Scale from lengths that somebody knows."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import scene
from test_floor import SHIFT, TURN, exact, poses_of

from mocap_calib.config import FloorConfig, ScaleCue, WorldConfig
from mocap_calib.errors import MismatchError
from mocap_calib.world.floor import find_floor, find_joints
from mocap_calib.world.lengths import Measurable, find_scale, statures

SCALE = 0.4  # of a metre


def measurable(bend: bool = False, **who) -> Measurable:
    """People with truth in lengths of 1 / SCALE metres; bend: their knees are where hips are."""
    made = scene(**{"people": 2, **who})
    positions = made.poses.copy()
    if bend:
        at = made.joints.index
        positions[:, :, [at("left_ankle"), at("right_ankle")]] = positions[
            :, :, [at("left_knee"), at("right_knee")]
        ] + [0.25, 0.0, 0.0]
    poses, joints = poses_of(positions, made.joints), find_joints(made.joints)
    rig = replace(made.rig, rotation=made.rig.rotation @ TURN.T)
    rig = replace(rig, translation=rig.translation - rig.rotation @ SHIFT)
    poses, rig = poses.scale(1 / SCALE, "arbitrary"), rig.scale(1 / SCALE, "arbitrary")
    floor = find_floor(poses, joints, FloorConfig())
    return Measurable(poses, joints, rig, floor, exact(rig))


def scale_of(*cues: ScaleCue, on: Measurable):
    return find_scale(cues, on, WorldConfig())


def stature(individual: int) -> float:
    """The height of the top of the head, over which the head's joints are proportional."""
    made = scene(people=2)
    top = made.poses[:, individual, made.joints.index("head_top"), 2]
    return float(np.quantile(top, 0.75))


def test_each_kind_of_length_gives_the_scale():
    """Measured: heights within 3 %, joints and cameras exactly, the truth being known."""
    on = measurable()
    made = scene(people=2)
    thigh = [made.poses[0, 0, made.joints.index(f"left_{name}")] for name in ("hip", "knee")]
    length = float(np.linalg.norm(thigh[0] - thigh[1]))
    apart = np.linalg.norm(made.rig.centres[0] - made.rig.centres[1])
    cues = {
        ScaleCue("height", stature(0), of="0"): 0.04,
        ScaleCue("length", length, of="left_hip-left_knee"): 0.06,
        ScaleCue("camera distance", float(apart), of="cam1-cam2"): 1e-6,
    }
    for cue, most in cues.items():
        found = scale_of(cue, on=on)
        assert abs(np.log(found.factor / SCALE)) < most, cue
        assert found.sigma < 0.1
    together = scale_of(*cues, on=on)
    assert abs(np.log(together.factor / SCALE)) < 0.01
    assert together.sigma < 0.002  # a distance of cameras outweighs the others
    assert len(together.cues) == 3


def test_stated_uncertainty_counts():
    on = measurable()
    sure, unsure = (
        scale_of(ScaleCue("length", 0.42, sigma, "left_hip-left_knee"), on=on).sigma
        for sigma in (0.0, 0.042)
    )
    assert unsure == pytest.approx(np.hypot(sure, 0.1))


def test_heights_are_of_each_who_stands_and_of_nobody_who_sits():
    on = measurable()
    found = statures(on, WorldConfig()) * SCALE
    assert found == pytest.approx([stature(0), stature(1)], rel=0.04)
    with pytest.raises(MismatchError, match="expected someone on a straight leg"):
        scale_of(ScaleCue("height", 1.75), on=measurable(bend=True))


@pytest.mark.parametrize(
    ("cues", "says"),
    [
        ([ScaleCue("length", 0.4, of="left_hip-left_kne")], "did you mean left_knee"),
        ([ScaleCue("length", 0.4, of="left_hip")], "as A-B, of .*, found .left_hip.; give two"),
        ([ScaleCue("camera distance", 3.0, of="cam1-cam9")], "'cam9'"),
        (
            [ScaleCue("height", 175)],
            "metres, 0.3 to 3, found 175; were centimetres meant. multiply by 0.01: 1.75 m",
        ),
        ([ScaleCue("height", 1750, of="0")], "were millimetres meant. multiply by 0.001: 1.75 m"),
        ([ScaleCue("height", 0.1)], "found 0.1; correct it"),
        ([ScaleCue("height", 1.7, of="5")], "expected an individual, one of 0, 1"),
        (
            [ScaleCue("height", 1.75), ScaleCue("camera distance", 40.0, of="cam1-cam2")],
            "height=1.75 m .* camera distance cam1-cam2=40 m .* correct or leave out one of them",
        ),
        (
            [ScaleCue("height", 1.8, of="0"), ScaleCue("height", 1.6, of="individual_0")],
            "found height of individual_0 twice",
        ),
    ],
)
def test_what_cannot_be_is_said_in_a_line(cues, says):
    with pytest.raises(MismatchError, match=says) as error:
        scale_of(*cues, on=measurable())
    assert "\n" not in str(error.value)


def test_lengths_are_above_0():
    for metres, sigma in ((0, 0), (-1, 0), (np.nan, 0), (1, 1), (1, -0.1)):
        with pytest.raises(ValueError, match="expected metres above 0"):
            ScaleCue("height", metres, sigma)
