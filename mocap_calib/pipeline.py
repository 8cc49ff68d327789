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
from mocap_calib.frames import informative, sample
from mocap_calib.matching import body_scale, match, match_everything, same_groups, settle
from mocap_calib.pairwise import calibrate_pairs, in_recording
from mocap_calib.parallel import single_threaded_libraries
from mocap_calib.recording import select_lifted, select_views
from mocap_calib.steerpose.lift import lift
from mocap_calib.steerpose.model import Lifter
from mocap_calib.triangulation import triangulate
from mocap_calib.types import Calibration, CameraRig, Ints, LiftedPoses, Matches, Progress, Recording, Sample

T = TypeVar("T")


@dataclass(frozen=True)
class Adjusted:
    """Adjusted rig, the labels it implies in the sample, and whether they stopped changing within the rounds allowed."""

    rig: CameraRig
    matches: Matches
    rounds: int
    converged: bool


def calibrate(recording: Recording, lifter: Lifter, config: Config, *, seed: int, device: str, progress: Progress) -> Calibration:
    """From a recording to cameras, matches and 3D poses. Raises DegenerateError where it does not determine them.

    The rig is found from a sample of the frames, of a size that does not depend on the length of the recording. The result does
    not depend on the number of threads.
    """
    with single_threaded_libraries():
        return _calibrate(recording, lifter, config, seed=seed, device=device, progress=progress)


def _calibrate(recording: Recording, lifter: Lifter, config: Config, *, seed: int, device: str, progress: Progress) -> Calibration:
    seconds: dict[str, float] = {}

    def timed(stage: str, work: Callable[[], T]) -> T:
        start = time.perf_counter()
        result = work()
        seconds[stage] = time.perf_counter() - start
        return result

    rng = np.random.default_rng(seed)
    chosen = timed("choose", lambda: informative(recording, config.sample))
    some = sample(recording, chosen)
    lifted = timed("lift", lambda: lift(some, lifter, device=device, progress=progress))
    pairs = timed("pairwise", lambda: calibrate_pairs(some, lifted, config.pairwise, rng=rng, progress=progress))
    kept = usable_cameras(recording.cameras, pairs, config.averaging)
    names = recording.names
    left_out = tuple(name for v, name in enumerate(names) if v not in kept)
    unused = tuple((names[p.a], names[p.b], p.score) for p in pairs if not {p.a, p.b} <= set(kept.tolist()))
    recording, some = select_views(recording, kept), select_views(some, kept)
    lifted, pairs = select_lifted(lifted, kept), of_cameras(pairs, kept)
    averaged = timed("average", lambda: average(recording.cameras, pairs, config.averaging))
    matches = timed("match", lambda: match(some, lifted, averaged.rig, config.matching, config.pairwise, progress=progress))
    adjusted = timed("adjust", lambda: adjust_to_fixed_point(some, lifted, averaged.rig, matches, config, progress=progress))
    everyone = timed("match all", lambda: match_all(recording, chosen, some, lifted, adjusted.rig, adjusted.matches, config, progress=progress))
    everyone = settle(recording, adjusted.rig, everyone, config.matching)
    within = Matches(everyone.labels[:, chosen])
    difference = timed("verdict", lambda: disagreement(some, adjusted.rig, within, config, seed=seed))
    poses = timed("triangulate", lambda: triangulate(recording, adjusted.rig, everyone, config.triangulate, progress=progress))
    return Calibration(
        recording,
        left_out,
        unused,
        in_recording(pairs, chosen),
        averaged,
        adjusted.rig,
        everyone,
        difference,
        poses,
        adjusted.rounds,
        adjusted.converged,
        seconds,
    )


def adjust_to_fixed_point(some: Sample, lifted: LiftedPoses, rig: CameraRig, matches: Matches, config: Config, *, progress: Progress) -> Adjusted:
    """Adjusts, matches from the adjusted geometry, and adjusts again until no detection changes its group."""
    rounds = config.adjust.rounds
    for done in range(1, rounds + 1):
        rig = adjust(some, rig, matches, config.adjust, config.triangulate, near=done > 1)
        progress("adjust", done, rounds)
        again = match(some, lifted, rig, config.matching, config.pairwise, progress=lambda *_: None)
        settled, matches = same_groups(again, matches), again
        if settled:
            break
    return Adjusted(rig, matches, done, settled)


def match_all(  # noqa: PLR0917 - a recording, its sample, and what is known of it
    recording: Recording, chosen: Ints, some: Sample, lifted: LiftedPoses, rig: CameraRig, matches: Matches, config: Config, *, progress: Progress
) -> Matches:
    """Who is who in a whole recording, of which the chosen frames (indices) made the sample that was matched."""
    scale = body_scale(some, lifted, rig, config.pairwise)
    return match_everything(recording, chosen, matches, rig, config, scale=scale, progress=progress)
