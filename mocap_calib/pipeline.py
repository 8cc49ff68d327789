"""The order of the stages and nothing else: pairs -> rig -> matches -> adjust -> triangulate."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mocap_calib.averaging import average, of_cameras, usable_cameras
from mocap_calib.bundle_adjustment import adjust
from mocap_calib.config import Config
from mocap_calib.determinacy import disagreement
from mocap_calib.matching import match, same_groups, settle
from mocap_calib.pairwise import calibrate_pairs
from mocap_calib.recording import select_lifted, select_views
from mocap_calib.steerpose.lift import lift
from mocap_calib.steerpose.model import Lifter
from mocap_calib.triangulation import triangulate
from mocap_calib.types import Calibration, CameraRig, LiftedPoses, Mapper, Matches, Progress, Recording

T = TypeVar("T")


@dataclass(frozen=True)
class Adjusted:
    """Adjusted rig, the labels it implies, and whether they stopped changing within the rounds allowed."""

    rig: CameraRig
    matches: Matches
    rounds: int
    converged: bool


def calibrate(recording: Recording, lifter: Lifter, config: Config, *, seed: int, device: str, progress: Progress, mapper: Mapper = map) -> Calibration:
    """From a recording to cameras, matches and 3D poses; `mapper` calibrates the pairs. Raises DegenerateError where it does not determine them."""
    seconds: dict[str, float] = {}

    def timed(stage: str, work: Callable[[], T]) -> T:
        start = time.perf_counter()
        result = work()
        seconds[stage] = time.perf_counter() - start
        return result

    rng = np.random.default_rng(seed)
    lifted = timed("lift", lambda: lift(recording, lifter, device=device, progress=progress))
    pairs = timed("pairwise", lambda: calibrate_pairs(recording, lifted, config.pairwise, rng=rng, progress=progress, mapper=mapper))
    kept = usable_cameras(recording.cameras, pairs, config.averaging)
    names = recording.names
    left_out = tuple(name for v, name in enumerate(names) if v not in kept)
    unused = tuple((names[p.a], names[p.b], p.score) for p in pairs if not {p.a, p.b} <= set(kept.tolist()))
    recording, lifted, pairs = select_views(recording, kept), select_lifted(lifted, kept), of_cameras(pairs, kept)
    averaged = timed("average", lambda: average(recording.cameras, pairs, config.averaging))
    matches = timed("match", lambda: match(recording, lifted, averaged.rig, config.matching, config.pairwise, progress=progress))
    adjusted = timed("adjust", lambda: adjust_to_fixed_point(recording, lifted, averaged.rig, matches, config, progress=progress))
    difference = timed("verdict", lambda: disagreement(recording, adjusted.rig, adjusted.matches, config, seed=seed))
    poses = timed("triangulate", lambda: triangulate(recording, adjusted.rig, adjusted.matches, config.triangulate, progress=progress))
    return Calibration(
        recording, left_out, unused, pairs, averaged, adjusted.rig, adjusted.matches, difference, poses, adjusted.rounds, adjusted.converged, seconds
    )


def adjust_to_fixed_point(recording: Recording, lifted: LiftedPoses, rig: CameraRig, matches: Matches, config: Config, *, progress: Progress) -> Adjusted:
    """Adjusts, matches from the adjusted geometry, and adjusts again until no detection changes its group."""
    rounds = config.adjust.rounds
    for done in range(1, rounds + 1):
        rig = adjust(recording, rig, matches, config.adjust, config.triangulate, near=done > 1)
        progress("adjust", done, rounds)
        again = match(recording, lifted, rig, config.matching, config.pairwise, progress=lambda *_: None)
        settled, matches = same_groups(again, matches), again
        if settled:
            break
    return Adjusted(rig, settle(recording, rig, matches, config.matching), done, settled)
