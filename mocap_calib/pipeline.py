"""The order of the stages and nothing else: pairs -> loops -> rig -> matches -> adjust -> triangulate."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError, LooseCameraError
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.multi_view.association import (
    body_scale,
    match,
    match_everything,
    same_groups,
    settle,
    single_subject,
)
from mocap_calib.multi_view.averaging import average, of_cameras
from mocap_calib.multi_view.bundle_adjustment import adjust
from mocap_calib.multi_view.factorization import factorise
from mocap_calib.multi_view.triangulation import triangulate
from mocap_calib.multi_view.uncertainty import alike, disagreement, fit, inconsistent, near_affine
from mocap_calib.multi_view.view_graph import camera_groups, choose_modes, several_groups
from mocap_calib.recording.sampling import informative, sample
from mocap_calib.recording.synchronise import select_lifted, select_views
from mocap_calib.steerpose.lift import lift
from mocap_calib.steerpose.model import Lifter
from mocap_calib.two_view.solve import PairSolver, calibrate_pairs, in_recording
from mocap_calib.types import (
    Calibration,
    CameraRig,
    Ints,
    LiftedPoses,
    Mapper,
    Matches,
    PairwiseCalibration,
    Progress,
    Recording,
    Sample,
)

T = TypeVar("T")
_SAME_DEG = 10.0


@dataclass(frozen=True)
class Adjusted:
    """Adjusted rig, the labels it implies in the sample, and whether they stopped changing within the rounds allowed."""

    rig: CameraRig
    matches: Matches
    rounds: int
    converged: bool


@dataclass(frozen=True)
class _Evidence:
    """What is known of some cameras: their recording, the frames (indices) chosen from it, these lifted, and the pairs."""

    recording: Recording
    chosen: Ints
    some: Sample
    lifted: LiftedPoses
    pairs: tuple[PairwiseCalibration, ...]

    def of(self, views: Ints) -> "_Evidence":
        """Of these views (indices) alone."""
        recording, some = select_views(self.recording, views), select_views(self.some, views)
        return _Evidence(
            recording,
            self.chosen,
            some,
            select_lifted(self.lifted, views),
            of_cameras(self.pairs, views),
        )


def calibrate(
    recording: Recording,
    lifter: Lifter,
    config: Config,
    *,
    seed: int,
    device: str,
    progress: Progress,
    mapper: Mapper | None = None,
    solve: PairSolver | None = None,
) -> Calibration:
    """From a recording whose cameras see the same bodies to cameras, matches and 3D poses; as `calibrate_groups`.

    Raises DegenerateError also where the cameras fall into groups.
    """
    first, *others = calibrate_groups(
        recording,
        lifter,
        config,
        seed=seed,
        device=device,
        progress=progress,
        mapper=mapper,
        solve=solve,
    )
    if others:
        raise several_groups(found.rig.names for found in (first, *others))
    return first


def calibrate_groups(
    recording: Recording,
    lifter: Lifter,
    config: Config,
    *,
    seed: int,
    device: str,
    progress: Progress,
    mapper: Mapper | None = None,
    solve: PairSolver | None = None,
) -> tuple[Calibration, ...]:
    """A calibration of each group of cameras that see the same bodies, the largest first; `mapper` has the pairs calibrated, by `solve` or our own search.

    The rigs are found from a sample of the frames, of a size that does not depend on the length of the recording. The result does not
    depend on the number of threads. Raises DegenerateError where the recording determines no rig; the cameras of a group that it does not
    determine are left out.
    """
    with single_threaded_libraries():
        return _calibrate_groups(
            recording,
            lifter,
            config,
            seed=seed,
            device=device,
            progress=progress,
            mapper=mapper,
            solve=solve,
        )


def _calibrate_groups(
    recording: Recording,
    lifter: Lifter,
    config: Config,
    *,
    seed: int,
    device: str,
    progress: Progress,
    mapper: Mapper | None,
    solve: PairSolver | None,
) -> tuple[Calibration, ...]:
    seconds: dict[str, float] = {}
    rng = np.random.default_rng(seed)
    chosen = _timed(seconds, "choose", lambda: informative(recording, config.sample))
    some = sample(recording, chosen)
    lifted = _timed(seconds, "lift", lambda: lift(some, lifter, device=device, progress=progress))
    pairs = _timed(
        seconds,
        "pairwise",
        lambda: calibrate_pairs(
            some, lifted, config.pairwise, rng=rng, progress=progress, mapper=mapper, solve=solve
        ),
    )
    pairs = _timed(seconds, "loops", lambda: choose_modes(pairs, config.averaging))
    evidence = _Evidence(recording, chosen, some, lifted, pairs)
    found: list[Calibration] = []
    refusals: list[DegenerateError] = []
    for views in camera_groups(recording.cameras, pairs, config.averaging):
        try:
            found.append(
                _calibrate_held(evidence.of(views), config, seconds, seed=seed, progress=progress)
            )
        except DegenerateError as error:
            refusals.append(error)
    if not found:
        raise refusals[0]
    names = recording.names
    home = {name: k for k, group in enumerate(found) for name in group.rig.names}
    left_out = tuple(name for name in names if name not in home)
    unused = tuple(
        (names[p.a], names[p.b], p.score)
        for p in pairs
        if home.get(names[p.a], -1) != home.get(names[p.b], -2)
    )
    return tuple(replace(group, left_out=left_out, unused=unused) for group in found)


def _calibrate_held(
    evidence: _Evidence, config: Config, seconds: dict[str, float], *, seed: int, progress: Progress
) -> Calibration:
    """Of those cameras of a group that can be held: one that too little agrees with must not cost the others theirs."""
    try:
        return _calibrate_group(evidence, config, dict(seconds), seed=seed, progress=progress)
    except LooseCameraError as loose:
        others = np.delete(np.arange(len(evidence.recording.cameras)), loose.view)
        if len(others) < 2:
            raise
        return _calibrate_held(evidence.of(others), config, seconds, seed=seed, progress=progress)


def _calibrate_group(
    evidence: _Evidence, config: Config, seconds: dict[str, float], *, seed: int, progress: Progress
) -> Calibration:
    """Of cameras that see the same bodies: rig -> matches -> adjust -> triangulate. seconds is filled."""
    recording, chosen, some, lifted, pairs = (
        evidence.recording,
        evidence.chosen,
        evidence.some,
        evidence.lifted,
        evidence.pairs,
    )
    averaged = _timed(
        seconds, "average", lambda: average(recording.cameras, pairs, config.averaging)
    )
    matches = _timed(
        seconds,
        "match",
        lambda: match(
            some, lifted, averaged.rig, config.matching, config.pairwise, progress=progress
        ),
    )
    adjusted, rival = _timed(
        seconds,
        "adjust",
        lambda: _best_start(some, lifted, averaged.rig, matches, config, progress=progress),
    )
    everyone = _timed(
        seconds,
        "match all",
        lambda: match_all(
            recording,
            chosen,
            some,
            lifted,
            adjusted.rig,
            adjusted.matches,
            config,
            progress=progress,
        ),
    )
    everyone = settle(recording, adjusted.rig, everyone, config.matching)
    within = Matches(everyone.labels[:, chosen, : some.positions.shape[2]])
    difference = _timed(
        seconds, "verdict", lambda: disagreement(some, adjusted.rig, within, config, seed=seed)
    )
    poses = _timed(
        seconds,
        "triangulate",
        lambda: triangulate(
            recording, adjusted.rig, everyone, config.triangulate, progress=progress
        ),
    )
    fitted = fit(some, adjusted.rig, within, config.triangulate)
    return Calibration(
        recording,
        (),
        (),
        in_recording(pairs, chosen),
        averaged,
        adjusted.rig,
        rival,
        everyone,
        difference,
        inconsistent(fitted),
        near_affine(fitted),
        poses,
        adjusted.rounds,
        adjusted.converged,
        seconds,
    )


def _timed(seconds: dict[str, float], stage: str, work: Callable[[], T]) -> T:
    start = time.perf_counter()
    result = work()
    seconds[stage] = time.perf_counter() - start
    return result


def _best_start(
    some: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    progress: Progress,
) -> tuple[Adjusted, CameraRig | None]:
    """The adjustment from the averaged rig; where no model helped, also from rigs found by factorisation, and the one that fits best.

    With it the rig that fits as well, if there is one: its reversal in depth. Raises DegenerateError where none of them can be adjusted.
    """
    alone = None if np.isfinite(lifted.centre).any() else single_subject(some)
    starts = [(rig, matches)]
    if alone is not None:
        starts += [(start, alone) for start in factorise(some, alone)]
    found: list[Adjusted] = []
    refusals: list[DegenerateError] = []
    for start, labels in starts:
        try:
            found.append(
                adjust_to_fixed_point(some, lifted, start, labels, config, progress=progress)
            )
        except DegenerateError as error:
            refusals.append(error)
    if not found:
        raise refusals[0]
    fits = [fit(some, each.rig, each.matches, config.triangulate) for each in found]
    best, *others = sorted(range(len(found)), key=lambda k: fits[k].misfit)
    rivals = [
        found[k].rig
        for k in others
        if alike(fits[k], fits[best]) and _turned(found[k].rig, found[best].rig) > _SAME_DEG
    ]
    return found[best], next(iter(rivals), None)


def _turned(first: CameraRig, second: CameraRig) -> float:
    """Degrees by which a camera is turned, against the first camera, in one rig and not in the other; the largest."""
    return float(
        np.rad2deg(
            angle_between(*(rig.rotation @ rig.rotation[0].T for rig in (first, second))).max()
        )
    )


def adjust_to_fixed_point(
    some: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    progress: Progress,
) -> Adjusted:
    """Adjusts, matches from the adjusted geometry, and adjusts again until no detection changes its group and no camera turns any more."""
    rounds = config.adjust.rounds
    for done in range(1, rounds + 1):
        before, rig = (
            rig,
            adjust(some, rig, matches, config.adjust, config.triangulate, near=done > 1),
        )
        progress("adjust", done, rounds)
        again = match(some, lifted, rig, config.matching, config.pairwise, progress=lambda *_: None)
        settled, matches = (
            same_groups(again, matches) and _turned(before, rig) < config.adjust.still_deg,
            again,
        )
        if settled:
            break
    return Adjusted(rig, matches, done, settled)


def match_all(  # noqa: PLR0917 - a recording, its sample, and what is known of it
    recording: Recording,
    chosen: Ints,
    some: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    progress: Progress,
) -> Matches:
    """Who is who in a whole recording, of which the chosen frames (indices) made the sample that was matched."""
    scale = body_scale(some, lifted, rig, config.pairwise)
    return match_everything(recording, chosen, matches, rig, config, scale=scale, progress=progress)
