"""From triangulated points to best estimates of the poses, an individual and a block at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import product
from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import Config, PosesConfig, TriangulateConfig
from mocap_calib.geometry.lens import rays_in_world
from mocap_calib.geometry.rotation import body_size
from mocap_calib.lift.lifter import load_vocabulary
from mocap_calib.poses.fit import (
    Body,
    Detections,
    Strengths,
    acceleration_steps,
    accelerations,
    bone_lengths,
    covariances,
    fill_gaps,
    fit,
    squared_errors,
    with_second_neighbours,
)
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.results import POINT_SOURCES, GroupResult, Matches, Poses3D, Smoothing
from mocap_calib.rig import Tracks, gather_tracks, view_noise
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Progress, Recording, silent

_TRIANGULATED = POINT_SOURCES.index("triangulated")
_ONE_VIEW = POINT_SOURCES.index("one view")
_INTERPOLATED = POINT_SOURCES.index("interpolated")
_BLOCK = 1000  # frames that are fitted at once, besides margins of four longest gaps
# of normal vectors in space, in standard deviations of a coordinate
_MEDIAN_LENGTH = 1.5382

Track = tuple[Floats, Detections, Body]  # points `[keypoint, frame, 3]` to start from, and the rest


@dataclass(frozen=True)
class _Individual:
    """What is known of one individual.

    index: of its label. frames: `[frame]` indices of those in which it is estimated. body: without
    steps, which are those of the frames that are fitted.
    """

    index: int
    frames: Ints
    body: Body


@dataclass(frozen=True)
class _Scene:
    """What is known of a recording: see `smooth_poses`.

    noise: `[view]` in radians. outlier: error in standard deviations of a detection that is wrong.
    """

    recording: Recording
    rig: CameraRig
    matches: Matches
    poses: Poses3D
    noise: Floats
    outlier: float
    config: PosesConfig

    @cached_property
    def edges(self) -> Ints:
        """`[edge, 2]` keypoints whose distance tells: those that one bone joins, or two in turn."""
        skeleton = load_vocabulary(self.recording.model)
        bones = edges_of_keypoints(skeleton, self.recording.vocabulary)
        joined = np.array(bones, dtype=np.int64).reshape(-1, 2)
        return with_second_neighbours(joined, len(self.recording.keypoints))

    @cached_property
    def times(self) -> Floats:
        """`[frame]` numbers of the frames in the usual step from one to the next."""
        frames = self.recording.frames
        usual = np.median(np.diff(frames)) if len(frames) > 1 else 1.0
        return np.asarray(frames / usual)

    @cached_property
    def individuals(self) -> list[_Individual]:
        """The individuals that were triangulated in enough frames."""
        individuals = range(self.poses.raw.shape[1])
        return [who for who in map_in_threads(self._find, individuals) if who is not None]

    def _find(self, index: int) -> _Individual | None:
        """Return what is known of the individual of an index, None where it is too little."""
        raw = self.poses.raw[:, index]
        seen = mapped.in_blocks(lambda rows: np.isfinite(raw[rows, :, 0]).any(1), len(raw))
        there = np.flatnonzero(seen)
        measured = mapped.some_frames(there)
        points = mapped.take(raw, measured)
        size = body_size(points)
        if len(there) < 3 or not size > 0:  # no acceleration, or no body
            return None
        variances = mapped.take(self.poses.covariance[:, index], measured)[..., (0, 3, 5)]
        sigma = np.sqrt(variances.sum(-1, dtype=np.float64))
        lengths, varies = bone_lengths(points, sigma, self.edges)
        gap = time_around(np.asarray(seen)[None], self.times).sum(0)[0]  # infinite at both ends
        frames = np.flatnonzero(gap <= self.config.longest_gap + 1)
        return _Individual(index, frames, Body(self.edges, lengths, varies, size, np.zeros((3, 0))))

    def track(self, who: _Individual, frames: Ints) -> Track:
        """Return what is known of an individual in frames (indices), from triangulated points."""
        own = Matches(np.where(self.matches.labels[:, frames] == who.index, 0, -1))
        recording = self.recording.select(frames=frames)
        seen = gather_tracks(recording, own, np.arange(len(frames)))
        detections = detections_of(
            self.rig, seen, self.noise, keypoints=len(self.recording.keypoints)
        )
        times = self.times[frames]
        steps = acceleration_steps(times, self.config.longest_gap + 1)
        points = fill_gaps(self.poses.raw[frames, who.index], times)
        points = np.ascontiguousarray(points.swapaxes(0, 1))
        return points, detections, replace(who.body, steps=steps)


@single_threaded_libraries()
def smooth_poses(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    poses: Poses3D,
    config: PosesConfig = PosesConfig(),
    *,
    triangulate: TriangulateConfig = TriangulateConfig(),
    progress: Progress = silent,
) -> tuple[Poses3D, Smoothing]:
    """Return the best estimates of poses, and how they were made.

    Points are moved to where they fit what was seen, how bodies move and how long their bones are,
    all as strongly as held-out detections say; short gaps are bridged, and joints that a single
    view saw are completed. What is not sure enough stays missing. docs/poses.md says how.

    poses: what `triangulate` found for the same recording, rig, matches and config `triangulate`.
    """
    if config.smooth == "off":
        return poses, Smoothing()
    noise = view_noise(recording, rig, matches, triangulate)
    scene = _Scene(recording, rig, matches, poses, noise, triangulate.outlier, config)
    if not scene.individuals:
        return poses, Smoothing()
    strengths, held_out, without = _choose(scene)
    arrays = _arrays_to_fill(poses, [who.index for who in scene.individuals])
    total = sum(len(who.frames) for who in scene.individuals)
    pieces = [(who, *block) for who in scene.individuals for block in blocks(who.frames, config)]

    def work(piece: tuple[_Individual, slice, Ints]) -> Ints:
        """Fit frames; return how many, and the number of outliers."""
        who, inner, frames = piece
        found, outliers = _estimate(scene, who, frames, strengths)
        own = frames[inner]
        for name, array in arrays.items():
            array[mapped.as_slice(own), who.index] = found[name][inner]
        return np.array([len(own), outliers[..., inner].sum()])

    counts = np.zeros(2, dtype=np.int64)
    for done in map_in_threads(work, pieces):
        counts += done
        mapped.let_go()
        progress("smooth", int(counts[0]), total)
    smoothing = Smoothing(
        acceleration=strengths.acceleration,
        bones=strengths.bones,
        loss=strengths.loss,
        held_out=held_out,
        held_out_raw=without,
        outliers=int(counts[1]),
    )
    return replace(poses, **arrays), smoothing


def smooth_group(group: GroupResult, config: Config, *, progress: Progress = silent) -> GroupResult:
    """Return a group with best estimates of its poses, see `smooth_poses`."""
    poses, smoothing = smooth_poses(
        group.recording,
        group.rig,
        group.matches,
        group.poses,
        config.poses,
        triangulate=config.triangulate,
        progress=progress,
    )
    return replace(group, poses=poses, smoothing=smoothing)


def _choose(scene: _Scene) -> tuple[Strengths, float, float]:
    """Return how strongly to smooth, see `choose_strengths`, by four stretches of frames.

    These are even over the frames of all individuals, as if they came one after the other.
    """
    config, individuals = scene.config, scene.individuals
    frames = np.concatenate([who.frames for who in individuals])
    owner = np.repeat(np.arange(len(individuals)), [len(who.frames) for who in individuals])
    middles = ((np.arange(4) + 0.5) * len(frames) / 4).astype(np.int64)
    around = np.arange(config.held_out_stretch) - config.held_out_stretch // 2
    places = np.unique(np.clip(middles[:, None] + around, 0, len(frames) - 1))
    tracks = [
        scene.track(individuals[each], frames[places[owner[places] == each]])
        for each in np.unique(owner[places]).tolist()
    ]
    return choose_strengths(tracks, config, moves=config.smooth != "bones")


def _estimate(
    scene: _Scene, who: _Individual, frames: Ints, strengths: Strengths
) -> tuple[dict[str, Any], Bools]:
    """Return the best estimates of one individual in frames that follow each other.

    By name: positions `[frame, keypoint, 3]`, covariance `[frame, keypoint, 6]`, source `[frame,
    keypoint]`. And which detections `[view, keypoint, frame]` were dropped.
    """
    config = scene.config
    points, seen, body = scene.track(who, frames)
    points = fit(points, seen, body, strengths, config, steps=2 * config.steps)
    seen, outliers = drop_outliers(points, seen, scene.outlier)
    points = fit(points, seen, body, strengths, config, steps=config.steps)
    wide = replace(strengths, loss=config.losses[0])  # a narrow loss weighs all errors as outliers
    covariance = covariances(points, seen, body, wide, config)
    met = np.isfinite(scene.poses.raw[frames, who.index, :, 0]).T
    moves = np.isfinite(strengths.acceleration)
    source = point_sources(seen, met, scene.times[frames], config.longest_gap if moves else -1)
    sigma = np.sqrt(covariance[..., (0, 3, 5)].sum(-1))
    source = np.where(sigma <= config.largest_sigma * body.size, source, 0)
    missing = (source == 0)[..., None]
    found = {
        "positions": np.where(missing, np.nan, points).swapaxes(0, 1),
        "covariance": np.where(missing, np.nan, covariance).swapaxes(0, 1),
        "source": source.T,
    }
    return found, outliers


def _arrays_to_fill(poses: Poses3D, fitted: list[int]) -> dict[str, Any]:
    """Return positions, covariance and source: of those who are fitted (indices), nothing yet.

    Of the others they are as they were triangulated.
    """
    known = {"positions": poses.raw, "covariance": poses.covariance, "source": poses.source}

    def rest(name: str, block: slice) -> Any:
        """Return an array in a block of frames without those who are fitted."""
        found = known[name][block].copy()
        found[:, fitted] = 0 if name == "source" else np.nan
        return found

    return {name: mapped.in_blocks(partial(rest, name), len(poses.frames)) for name in known}


def detections_of(rig: CameraRig, seen: Tracks, noise: Floats, *, keypoints: int) -> Detections:
    """Return the detections of an individual.

    All detections of a view count alike: weights by confidence make poses of some detectors worse.

    seen: of N = frames x keypoints. noise: `[view]` in radians.
    """
    views = len(rig)
    rays = rays_in_world(rig, seen.rays).reshape(views, 3, -1, keypoints).transpose(1, 0, 3, 2)
    known = np.isfinite(seen.rays[:, 0]) & (seen.weight > 0)
    precision = (known / noise[:, None] ** 2).reshape(views, -1, keypoints).swapaxes(1, 2)
    return Detections(np.ascontiguousarray(rays), np.ascontiguousarray(precision), rig.centres)


# Gaps that are bridged, and blocks of frames


def time_around(there: Bools, times: Floats) -> Floats:
    """Return times `[2, keypoint, frame]`: since the last that is there, and to the next."""
    last = np.maximum.accumulate(np.where(there, times, -np.inf), axis=1)
    following = np.minimum.accumulate(np.where(there, times, np.inf)[:, ::-1], axis=1)[:, ::-1]
    return np.stack([times - last, following - times])


def point_sources(seen: Detections, met: Bools, times: Floats, longest: int) -> Ints:
    """Return what points are made of, `[keypoint, frame]`, 0 = missing.

    met: `[keypoint, frame]` whether there is a point that was started from. longest: gap that is
    bridged, and distance from a triangulated point up to which one view will do: along its ray a
    point may be at either of two places. Below 0 neither is.
    """
    views = (seen.precision > 0).sum(0)
    firm = met & (views >= 2)
    gap = time_around(views > 0, times)
    source = np.where(gap.sum(0) <= longest + 1, _INTERPOLATED, 0)
    near = time_around(firm, times).min(0) <= longest
    source = np.where(views > 0, np.where(near, _ONE_VIEW, 0), source)
    return np.where(firm, _TRIANGULATED, source)


def blocks(frames: Ints, config: PosesConfig) -> Iterator[tuple[slice, Ints]]:
    """Yield frames to fit at once, and which of them are new there: the others are margins."""
    margin = 4 * config.longest_gap
    for start in range(0, len(frames), _BLOCK):
        first = max(start - margin, 0)
        last = start + _BLOCK
        own = frames[first : last + margin]
        yield slice(start - first, min(last, len(frames)) - first), own


# How strongly to smooth


def choose_strengths(
    tracks: Sequence[Track], config: PosesConfig, *, moves: bool
) -> tuple[Strengths, float, float]:
    """Return the strengths that predict hidden detections best, and how well they do.

    That is the mean of log(1 + r^2 / 4), r the error of the hidden detections in standard
    deviations, with smoothing and without; NaN where no detection was hidden: where too few points
    have three views to hide one, the strengths follow from the accelerations of the points.

    moves: whether accelerations may be smoothed.
    """
    usual = usual_strengths(tracks, config, moves=moves)
    hidden = [_hide(seen, config) for _, seen, _ in tracks]
    if sum(map(np.count_nonzero, hidden)) < 2 * config.held_out_stretch:
        return usual, np.nan, np.nan

    shown = [
        replace(seen, precision=np.where(away, 0.0, seen.precision))
        for (_, seen, _), away in zip(tracks, hidden, strict=True)
    ]

    @cache
    def loss(strengths: Strengths) -> float:
        """Return the mean loss of the hidden detections."""
        errors = []
        for (points, seen, body), rest, away in zip(tracks, shown, hidden, strict=True):
            found = fit(points, rest, body, strengths, config, steps=config.steps)
            errors.append(squared_errors(found, seen)[away])
        return float(np.log1p(np.concatenate(errors) / 4).mean())

    accelerations = config.accelerations if np.isfinite(usual.acceleration) else ()
    tried = [
        Strengths(acceleration, usual.bones, width)
        for acceleration, width in product((np.inf, *accelerations), config.losses)
    ]
    best = min(tried, key=loss)
    if np.isfinite(usual.bones):
        best = min((replace(best, bones=each) for each in config.bones), key=loss)
    return best, loss(best), loss(replace(best, acceleration=np.inf, bones=np.inf))


def usual_strengths(tracks: Sequence[Track], config: PosesConfig, *, moves: bool) -> Strengths:
    """Return strengths without held-out detections: weak ones.

    Accelerations are allowed that are as large as those of the points, noise included; where even
    these are too large for one motion, frames do not follow each other.
    """
    sizes = [np.zeros(0)]
    for points, seen, body in tracks:
        acceleration = accelerations(points, body)
        ends = acceleration.shape[1]
        there = (seen.precision > 0).sum(0) >= 2
        counted = np.all([there[:, k : k + ends] for k in range(3)], axis=0)
        counted &= body.steps[0, :ends] != 0
        sizes.append(np.linalg.norm(acceleration[counted], axis=-1) / body.size)
    found = np.concatenate(sizes)
    sigma = float(np.median(found)) / _MEDIAN_LENGTH if len(found) else np.inf
    allowed = sigma if moves and sigma < config.accelerations[0] else np.inf
    bones = config.bones[0] if tracks[0][2].edges.size else np.inf
    return Strengths(max(allowed, config.accelerations[-1]), bones, config.losses[0])


def _hide(seen: Detections, config: PosesConfig) -> Bools:
    """Return which detections `[view, keypoint, frame]` are hidden.

    Of every point that three views or more detect, one view is hidden: two of each point stay. A
    joint is hidden from a view for runs of half a stretch, as errors are correlated in time: with 5
    frames the detections just before and after are as wrong, and Shelf is smoothed as much as can
    be.
    """
    there = seen.precision > 0
    views, joints, frames = there.shape
    length = max(config.held_out_stretch // 2, 1)
    views_of_runs = np.random.default_rng(0).integers(views, size=(joints, frames // length + 1))
    chosen = views_of_runs.repeat(length, axis=1)[:, :frames] == np.arange(views)[:, None, None]
    return chosen & there & (there.sum(0) >= 3)


def drop_outliers(points: Floats, seen: Detections, outlier: float) -> tuple[Detections, Bools]:
    """Return the detections without those far from the points, and which these are.

    points: `[keypoint, frame, 3]`. Which: `[view, keypoint, frame]`.
    """
    far = (seen.precision > 0) & (squared_errors(points, seen) > outlier**2)
    return replace(seen, precision=np.where(far, 0.0, seen.precision)), far
