"""Numbers that follow from poses, through the command: of known motions, and where some lack."""

import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scenes import scene

import mocap_calib as mc
from mocap_calib.types import World

FLOOR = World("floor", up=np.array([0.0, 0, 1]), floor=np.zeros(3))
LEG = ("left_hip", "left_knee", "left_ankle")


def poses(keypoints, positions, frames=None, world=FLOOR) -> mc.Poses3D:
    frames = np.arange(len(positions)) if frames is None else np.array(frames)
    known = np.isfinite(np.asarray(positions, float)).all(-1) * 1.0
    return mc.Poses3D(keypoints, frames, positions, known, 2 * known, known, "m", world=world)


def walkers(noise: float = 0.0, **changes) -> mc.Poses3D:
    made = scene(people=2, frames=150, **changes)
    moved = made.poses + noise * np.random.default_rng(0).normal(size=made.poses.shape)
    return poses(made.joints, moved)


@dataclass(frozen=True)
class Measured:
    """The rows of both tables, and what the command said."""

    rows: list[dict[str, str]]
    bones: list[dict[str, str]]
    said: str

    def column(self, name: str, individual: int = 0) -> np.ndarray:
        """Return a column of an individual, NaN = missing."""
        own = [row for row in self.rows if row["individual"] == f"individual_{individual}"]
        return np.array([float(row[name] or "nan") for row in own])

    def columns(self, part: str) -> set[str]:
        return {name for name in (self.rows[0] if self.rows else {}) if part in name}


Measure = Callable[..., Measured]


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def measure(tool, tmp_path) -> Measure:
    def run(given: mc.Poses3D, fps: float | None = 30.0) -> Measured:
        mc.write(given, tmp_path / "poses.h5")
        rate = () if fps is None else ("--fps", fps)
        done = tool("kinematics", tmp_path / "poses.h5", "-o", tmp_path / "out", *rate)
        assert (done.returncode, done.stdout) == (0, ""), done.stderr
        tables = (read(tmp_path / "out" / f"{name}.csv") for name in ("kinematics", "bones"))
        return Measured(*tables, done.stderr)

    return run


def test_an_angle_is_the_included_one(measure):
    """The sixth has a knee in the hip."""
    degrees = np.array([0.0, 30, 90, 179, 180, np.nan])
    turn = np.radians(np.nan_to_num(degrees))
    legs = np.zeros((6, 1, 3, 3))
    legs[:, 0, 0, 0] = 2.0
    legs[:, 0, 2] = 3 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    legs[5, 0, 1] = legs[5, 0, 0]
    found = measure(poses(LEG, legs)).column("left_knee_angle_deg")
    np.testing.assert_allclose(found, degrees, atol=1e-4)


def test_speed_knows_frame_numbers_rate_and_gaps(measure):
    """A trunk whose joints come and go does not jump."""
    names = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    still = np.array([[0, 1, 2], [0, -1, 2], [0, 1, 0], [0, -1, 0.0]])
    frames = np.delete(np.arange(34), [5, 6, 7, 20])
    moving = (still + frames[:, None, None] * np.array([0.1, 0, 0]))[:, None]
    moving[np.random.default_rng(0).random((30, 1, 4)) < 0.3] = np.nan
    given = poses(names, moving, frames)
    for fps, unit, speed in ((None, "m_per_frame", 0.1), (20.0, "m_per_s", 2.0)):
        found = measure(given, fps).column(f"body_speed_{unit}")
        np.testing.assert_allclose(found[np.isfinite(found)], speed, rtol=1e-5)
        assert np.isfinite(found).mean() > 0.8


def test_bones_have_the_lengths_that_they_have(measure):
    legs = np.zeros((500, 1, 3, 3))
    legs[:, 0, 1, 0] = 0.4 + 0.02 * np.random.default_rng(1).normal(size=500)
    legs[:, 0, 2] = np.nan
    legs[7, 0, 1] = np.nan
    (thigh,) = (row for row in measure(poses(LEG, legs)).bones if row["frames"] != "0")
    assert (float(thigh["mean"]), float(thigh["sd"])) == pytest.approx((0.4, 0.02), rel=0.1)
    assert (thigh["bone"], thigh["frames"], thigh["unit"]) == ("left_hip-left_knee", "499", "m")


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_walkers_stand_on_a_foot_most_of_the_time(measure, noise):
    """Measured: 0.7 to 0.9 of the time on each foot, always on one; slowly, and low."""
    found = measure(walkers(noise))
    assert found.columns("contact") == {"left_foot_contact", "right_foot_contact"}
    for individual in range(2):
        sides = [found.column(f"{side}_foot_contact", individual) for side in ("left", "right")]
        assert all(0.55 < np.nanmean(each) < 0.97 for each in sides)
        assert np.nanmean(sum(sides) >= 1) > 0.95


def test_a_body_that_hangs_has_no_contacts(measure):
    high = walkers()
    hanging = replace(high, positions=high.positions + np.array([0, 0, 0.5]))
    assert np.nansum(measure(hanging).column("left_foot_contact")) == 0


def test_contacts_need_a_floor_a_rate_feet_and_legs(measure):
    """Without one of them the command says which, and all else is measured."""
    paws = tuple(f"{side}_{paw}" for side in ("left", "right") for paw in ("forepaw", "hindpaw"))
    mouse = ("nose", "tail_base", *paws)
    for changed, rate, reason in (
        (replace(walkers(), world=World()), 30.0, "floor"),
        (walkers(), None, "--fps"),
        (poses(("a", "b"), np.zeros((3, 1, 2, 3))), 30.0, "feet"),
        (poses(mouse, np.zeros((3, 1, 6, 3))), 30.0, "leg"),
    ):
        found = measure(changed, rate)
        assert not found.columns("contact")
        assert any("contact" in line and reason in line for line in found.said.splitlines())


@pytest.mark.parametrize("shape", [(1, 1), (3, 0), (4, 2)])
def test_whatever_is_missing_makes_tables_without_a_number(measure, tmp_path, shape):
    found = measure(poses(LEG, np.full((*shape, 3, 3), np.nan)))
    assert not found.rows
    assert len(found.bones) == 2 * shape[1]
    assert "nan" not in (tmp_path / "out" / "bones.csv").read_text()


@pytest.mark.parametrize(
    ("who", "angles"),
    [
        ({"people": 2}, {"left_knee", "right_elbow"}),
        ({"animals": (("quadruped", 1),)}, {"left_elbow", "right_knee", "spine", "tail"}),
        ({"animals": (("rodent", 1),)}, set()),
    ],
)
def test_each_kind_of_body_is_measured_by_its_own_table(measure, who, angles):
    """Of both sides, of what the recording has; the numbers are those of the scene's joints."""
    made = scene(**{"people": 0, **who})
    keep = np.isfinite(made.poses).all((0, 1, 3))
    names = tuple(name for name, there in zip(made.joints, keep, strict=True) if there)
    found = measure(poses(names, made.poses[:, :, keep]))
    measured = {name.removesuffix("_angle_deg") for name in found.columns("_angle_deg")}
    assert angles <= measured
    for name in measured:
        assert "right_" + name.removeprefix("left_") in measured or not name.startswith("left_")
        angle = found.column(f"{name}_angle_deg")
        assert 0 <= np.nanmin(angle) <= np.nanmax(angle) <= 180
    if "left_knee" in angles:
        hip, knee, ankle = (made.poses[:, 0, made.joints.index(name)] for name in LEG)
        ends = [each / np.linalg.norm(each, axis=1)[:, None] for each in (hip - knee, ankle - knee)]
        expected = np.degrees(np.arccos((ends[0] * ends[1]).sum(1)))
        np.testing.assert_allclose(found.column("left_knee_angle_deg"), expected, rtol=1e-4)
