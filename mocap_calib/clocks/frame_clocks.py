"""Find how the clocks of cameras differ, from lifted bodies, before there is a rig.

compare pairs in time -> constant offsets -> rates and lost frames -> hold against in step.

A clock is called different only where the evidence is decisive: the cameras agree better than they
do in step, under the best rotation of each pair in either case, by several standard errors over
blocks of time; and no other offset that is no neighbour does nearly as well. Cameras of which
nothing decisive is found stay as they are. Then the others are judged again: each must also differ
from the cameras that stay.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mocap_calib.clocks.evidence import weigh_clock
from mocap_calib.clocks.kinds import StretchNumbers, describe_clock
from mocap_calib.clocks.paths import Agreements, Pair, standardise
from mocap_calib.clocks.search import Timing, find_timing, on_common_clock
from mocap_calib.clocks.timing import FrameAgreement, ViewInTime, compare_in_time
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import CROWDED_QUANTILE, SyncConfig
from mocap_calib.recording.retiming import clocks_from
from mocap_calib.results import Clocks, LiftedPoses
from mocap_calib.types import Bools, CameraClock, Ints, Recording


def find_clocks(
    recording: Recording, lifted: LiftedPoses, stretches: Ints, config: SyncConfig, *, seed: int
) -> Clocks:
    """Return how the clocks of the cameras differ.

    lifted: the bodies of all frames of the stretches, one stretch after the other.
    stretches: `[stretch, frame]` indices of the frames, -1 = not in the recording.
    """
    views = views_in_time(lifted, stretches, config)
    window = min(config.window, stretches.shape[1] // 3)
    config = replace(config, window=window)
    found = _compare_all(views, config, seed)
    if not found or window < 1:
        return Clocks.of_one(recording)
    values = {pair: standardise(each) for pair, each in found.items()}
    agreements = Agreements(len(views), found, values, window)
    timing = find_timing(agreements, _choose_rates(found, len(views)), config)
    timing = on_common_clock(agreements, timing)
    numbers = StretchNumbers.of(recording, stretches)
    describe = partial(_describe, recording.names, numbers, views, agreements, config=config)
    cameras = describe(timing)
    differ = [clock.differs for clock in cameras]
    while any(differ):
        # the others stay as they are: beside them, a camera of their room that moves alone agrees
        # less
        timing = timing.in_step_but(differ)
        cameras = describe(timing)
        before, differ = differ, [clock.differs for clock in cameras]
        if differ == before:
            break
    return clocks_from(recording, doubt_lost_frames(cameras, config))


def _describe(
    names: Sequence[str],
    numbers: StretchNumbers,
    views: list[ViewInTime],
    agreements: Agreements,
    timing: Timing,
    *,
    config: SyncConfig,
) -> tuple[CameraClock, ...]:
    """Return what kind of clock each camera has, by the evidence for its map beside the others'."""
    found = []
    for view, name in enumerate(names):
        ridge, rate = timing.ridges[view], timing.rates[view]
        evidence = weigh_clock(
            agreements, views, view, ridge, rate=rate, maps=timing.maps, config=config
        )
        clock = describe_clock(
            name, ridge.frames, rate, numbers=numbers, evidence=evidence, config=config
        )
        found.append(clock)
    return tuple(found)


def doubt_lost_frames(
    cameras: tuple[CameraClock, ...], config: SyncConfig
) -> tuple[CameraClock, ...]:
    """Return the clocks without steps of several cameras on which the others do not agree.

    A map with steps bends to noise that is the same for some time (a wrong person, a joint that is
    lost). Measured: where several of four recordings' sound cameras seemed to have lost frames, at
    most 0.4 of the others agreed best there; all of them where they had.
    """
    doubtful = [
        clock.kind == "dropped" and clock.evidence["votes"] < config.least_votes
        for clock in cameras
    ]
    if sum(doubtful) < 2:
        return cameras
    return tuple(
        CameraClock(clock.camera, "not known", evidence=clock.evidence) if doubt else clock
        for clock, doubt in zip(cameras, doubtful, strict=True)
    )


def views_in_time(lifted: LiftedPoses, stretches: Ints, config: SyncConfig) -> list[ViewInTime]:
    """Return the bodies of each view in stretches of consecutive frames.

    lifted, stretches: as of `find_clocks`.
    """
    seen: Bools = np.asarray(np.isfinite(lifted.body).all((-2, -1)))
    body = np.where(seen[..., None, None], lifted.body, 0.0)
    covariance = np.einsum("vfijx,vfikx->jk", body, body, optimize=True)
    axes = np.linalg.eigh(covariance)[1][:, -config.axes :]
    compact = np.einsum("vfijx,jk->vfikx", body, axes, optimize=True) / np.sqrt(len(axes))
    row = np.cumsum(stretches.ravel() >= 0).reshape(stretches.shape) - 1
    missing: Bools = np.asarray(stretches < 0)
    row = np.where(missing, 0, row)
    first = np.argsort(~seen, axis=2, kind="stable")
    seen_first: Bools = np.take_along_axis(seen, first, 2)
    compact = np.take_along_axis(compact, first[..., None, None], 2).astype(np.float32)
    return [
        _without_crowd(ViewInTime(of_view[row], seen_by[row] & ~missing[..., None]))
        for of_view, seen_by in zip(compact, seen_first, strict=True)
    ]


def _without_crowd(view: ViewInTime) -> ViewInTime:
    """Return the view with as many instances as nearly all frames have, those seen first."""
    several = view.seen.sum(-1)[view.seen.any(-1)]
    count = max(1, int(np.quantile(several, CROWDED_QUANTILE))) if len(several) else 1
    return ViewInTime(view.body[:, :, :count], view.seen[:, :, :count])


def _compare_all(
    views: list[ViewInTime], config: SyncConfig, seed: int
) -> dict[Pair, FrameAgreement]:
    """Return how the pairs of views agree in time; pairs of which one sees too little are not."""
    pairs = choose_pairs(len(views))
    generators = np.random.default_rng(seed).spawn(len(pairs))
    compared = map_in_threads(
        lambda job: compare_in_time(views[job[0][0]], views[job[0][1]], config, job[1]),
        zip(pairs, generators, strict=True),
    )
    return {pair: each for pair, each in zip(pairs, compared, strict=True) if each is not None}


def choose_pairs(views: int) -> list[Pair]:
    """Return the pairs of so many views that are compared, in order.

    Up to seven views, all. Of more, each is compared with two on either side in a ring and with
    that across, or the two nearest to it: the work grows as their number. With fewer partners,
    frames that all cameras lost were found in fewer of the eight of two dogs.
    """
    distances = np.unique([1, 2, views // 2])
    first = np.repeat(np.arange(views), len(distances))
    second = (first + np.tile(distances, views)) % views
    pairs = np.sort(np.stack([first, second], 1), axis=1)
    return [(a, b) for a, b in np.unique(pairs, axis=0).tolist() if a < b]


def _choose_rates(found: dict[Pair, FrameAgreement], views: int) -> tuple[float, ...]:
    """Return the rate of each camera: another than 1 where most of its pairs say so."""
    rates = [1.0] * views
    for rate in (0.5, 2.0):
        for view in range(views):
            said = []
            for (a, b), each in sorted(found.items()):
                if view in (a, b) and rates[a] == rates[b] == 1.0:
                    said.append(each.rate == (rate if view == b else 1 / rate))
            if sum(said) > len(said) / 2:
                rates[view] = rate
    return tuple(rates)
