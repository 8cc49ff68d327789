"""What is known of views: pairs, and tracks of points, each a keypoint of one body in a frame.

Also the labels that tracks are gathered by, and the angular noise of each view's detections. A
triangulated point absorbs a part of the errors of its rays, so residuals are smaller than the
errors. `view_noise` is the standard deviation of the errors, for weights and covariances of points;
`measure_residuals` has that of the residuals, for limits and robust losses.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import TriangulateConfig
from mocap_calib.errors import UnderconstrainedCameraError
from mocap_calib.geometry import lens
from mocap_calib.geometry.intersection import ViewBlock, intersect, median_angles, view_blocks
from mocap_calib.geometry.lens import ray_angles, rays_in_world
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import LiftedPoses, Matches, PairwiseCalibration
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording, Sample

T = TypeVar("T")

# The median distance of a normal error in the plane from its centre, sqrt(2 log 2), in standard
# deviations of one coordinate
MEDIAN_DISTANCE = 1.18
LEAST_POINTS = 30  # of a view: with fewer it is not known by itself


@dataclass(frozen=True, eq=False, repr=False)
class Tracks:
    """The detections of N points, by view and by component.

    pixels: `[view, 2, N]`, NaN = missing.
    rays: `[view, 3, N]` unit vectors in each camera's frame, NaN = missing.
    weight: `[view, N]` of each detection, 0 = missing or not used; the confidence, as gathered.
    frame, individual, keypoint: `[N]` indices.
    """

    pixels: Floats
    rays: Floats
    weight: Floats
    frame: Ints
    individual: Ints
    keypoint: Ints

    @property
    def used(self) -> Bools:
        """`[view, N]` the detections that have a weight."""
        return np.asarray(self.weight > 0)

    def select(self, points: Ints) -> "Tracks":
        """Return the tracks of some of the points (`[n]` indices)."""
        return Tracks(
            pixels=self.pixels[..., points],
            rays=self.rays[..., points],
            weight=self.weight[:, points],
            frame=self.frame[points],
            individual=self.individual[points],
            keypoint=self.keypoint[points],
        )

    def time_blocks(self, blocks: int) -> Ints:
        """Return the number `[N]`, below `blocks`, of the period that each point belongs to.

        Periods have about equally many frames.
        """
        frames, rank = np.unique(self.frame, return_inverse=True)
        return np.asarray(rank * blocks // max(len(frames), 1), dtype=np.int64)

    def link_blocks(self, blocks: int) -> Ints:
        """Return the number `[N]`, below `blocks`, of the period of its link of each point.

        Two views are linked by the points that both see, the weakest link of a point being that of
        the fewest. Links that hold for a part of the time have periods of their own.
        """
        views, view_set = np.unique(self.used, axis=1, return_inverse=True)
        shared = self.used.astype(np.float64) @ self.used.T
        np.fill_diagonal(shared, np.inf)
        both = views[:, None] & views
        link = np.where(both, shared[..., None], np.inf).reshape(-1, views.shape[1]).argmin(0)
        link_of, period = link[view_set.ravel()], np.zeros(len(self.frame), dtype=np.int64)
        for each in np.unique(link):
            some = np.flatnonzero(link_of == each)
            period[some] = self.select(some).time_blocks(blocks)
        return period


@dataclass(frozen=True)
class Observed:
    """What is known of some cameras before a rig is built.

    sample_frames: `[frame]` indices into the recording of the frames of the sample.
    lifted: the detections of the sample, lifted. pairs: between these cameras.
    """

    recording: Recording
    sample_frames: Ints
    sample: Sample
    lifted: LiftedPoses
    pairs: tuple[PairwiseCalibration, ...]

    @property
    def rotations(self) -> dict[tuple[int, int], Floats]:
        """(a, b) -> `[3, 3]` b_from_a of each pair."""
        return {(pair.a, pair.b): pair.rotation for pair in self.pairs}

    def select(self, views: Ints) -> "Observed":
        """Return what is known of these views (`[view]` indices) alone."""
        return Observed(
            recording=self.recording.select(views=views),
            sample_frames=self.sample_frames,
            sample=self.sample.select(views=views),
            lifted=self.lifted.select(views),
            pairs=pairs_among(self.pairs, views),
        )

    def without(self, camera: str) -> "Observed":
        """Return what is known of all cameras but this one."""
        names = self.recording.names
        return self.select(np.array([v for v, name in enumerate(names) if name != camera]))


def leave_out_underconstrained(observed: Observed, work: Callable[[Observed], T]) -> T:
    """Return what is found of the cameras of one group that are constrained.

    A camera that sees too little that agrees with others must not cost the others their rig: it
    is left out, and the work on the rest starts again.
    """
    while True:
        try:
            return work(observed)
        except UnderconstrainedCameraError as error:
            if len(observed.recording.cameras) == 2:
                raise
            observed = observed.without(error.camera)


def pairs_among(
    pairs: tuple[PairwiseCalibration, ...], cameras: Ints
) -> tuple[PairwiseCalibration, ...]:
    """Return the pairs among some cameras, renumbered to the order of these.

    cameras: `[view]` indices.
    """
    place = {int(camera): k for k, camera in enumerate(cameras)}
    return tuple(
        replace(
            pair,
            a=place[pair.a],
            b=place[pair.b],
            alternatives=pairs_among(pair.alternatives, cameras),
        )
        for pair in pairs
        if pair.a in place and pair.b in place
    )


def gather_tracks(recording: Recording, matches: Matches, frames: Ints) -> Tracks:
    """Return the detections of all individuals in some frames (`[frame]` indices).

    Those that a lens model cannot undistort have no weight. N = frames x individuals x keypoints,
    in that order.
    """
    part, labels = recording.select(frames=frames), matches.labels[:, frames]
    view, at, instance = np.nonzero(labels >= 0)
    own = view, at, labels[view, at, instance]
    views, shape = len(labels), (len(frames), matches.individuals, len(recording.keypoints))
    pixels, confidence = np.full((views, *shape, 2), np.nan), np.zeros((views, *shape))
    pixels[own] = part.positions[view, at, instance]
    confidence[own] = part.confidence[view, at, instance]
    pixels = pixels.reshape(views, -1, 2)
    rays = lens.unproject_views(recording.cameras, pixels, by_component=True)
    frame, individual, keypoint = (index.ravel() for index in np.indices(shape))
    return Tracks(
        pixels=np.ascontiguousarray(np.moveaxis(pixels, -1, 1)),
        rays=rays,
        weight=np.where(np.isnan(rays[:, 0]), 0.0, confidence.reshape(views, -1)),
        frame=frames[frame],
        individual=individual,
        keypoint=keypoint,
    )


def labelled_frames(matches: Matches) -> Ints:
    """Return the indices `[frame]` of the frames with any label."""
    return np.flatnonzero((matches.labels >= 0).any((0, 2)))


def per_frame_labels(matches: Matches) -> Matches:
    """Return the same groups, numbered from 0 in each frame by their first detection.

    The names that groups have in other frames are forgotten. Labels are
    `[view, frame, instance]`, -1 = nobody.
    """
    labels = matches.labels
    return Matches(
        mapped.in_blocks(lambda block: _number_groups(labels[:, block]), labels.shape[1], axis=1)
    )


def _number_groups(labels: Ints) -> Ints:
    """Return the groups `[view, frame, instance]` of some frames, numbered in each frame."""
    views, frames, instances = labels.shape
    flat = np.swapaxes(labels, 0, 1).reshape(frames, views * instances)
    alike = flat[:, :, None] == flat[:, None]
    first = alike.argmax(-1)  # the first detection of the frame with the same label
    begins = (first == np.arange(views * instances)) & (flat >= 0)
    number = np.take_along_axis(begins.cumsum(1) - 1, first, axis=1)
    numbered = np.where(flat >= 0, number, -1)
    return np.swapaxes(numbered.reshape(frames, views, instances), 0, 1)


def matched_share(recording: Recording, matches: Matches) -> Floats:
    """Return the share `[view]` of the detections that are matched with somebody."""
    detected = recording.detected
    matched = detected & (matches.labels >= 0)
    return np.asarray(matched.sum((1, 2)) / np.maximum(detected.sum((1, 2)), 1))


def replace_labels(labels: Ints, names: Ints) -> Ints:
    """Return `names[label]` for each of the labels, an array of any shape; -1 stays -1.

    names: `[label]`.
    """
    return np.append(names, -1)[labels]  # the last entry is the one that -1 finds


def name_groups(groups: Ints, names: Ints) -> Ints:
    """Return the labels `[view, frame, instance]` of groups whose names are `[frame, group]`."""
    frame = np.arange(len(names))[:, None]
    padded = np.concatenate([names, np.full((len(names), 1), -1)], axis=1)
    return np.asarray(padded[frame, groups])


def view_noise(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular error, in radians.

    Of one coordinate, from an even sample of the labelled frames, on the points that three views
    see (two where there are no more).
    """
    tracks = _sample_tracks(recording, matches, config)
    return noise_of_rays(rig, tracks.rays, tracks.weight, config)


def noise_of_rays(
    rig: CameraRig, rays: Floats, weight: Floats, config: TriangulateConfig
) -> Floats:
    """Return what `view_noise` does, from rays `[view, 3, N]` of weights `[view, N]`.

    Angles between rays and the points where they meet count by their medians where each ray has an
    error of one standard deviation (`geometry.intersection`).
    """
    points, angle, counted = _measure_angles(rig, rays, weight, config)
    return _medians_of_views(rig, angle / median_angles(rig, points, weight), counted, config)


def measure_residuals(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> tuple[Floats, Floats]:
    """Return the robust standard deviation `[view]` of each view's angular residual, in radians.

    On the same points as `view_noise`. And the lengths `[N]` of the errors behind the residuals, in
    standard deviations of one coordinate of each view's own; what points took up is made up for.
    """
    tracks = _sample_tracks(recording, matches, config)
    points, angle, counted = _measure_angles(rig, tracks.rays, tracks.weight, config)
    residual = _medians_of_views(rig, angle / MEDIAN_DISTANCE, counted, config)
    error = angle / median_angles(rig, points, tracks.weight)
    noise = _medians_of_views(rig, error, counted, config)
    return residual, (MEDIAN_DISTANCE * error / noise[:, None])[counted]


def least_noise(rig: CameraRig, config: TriangulateConfig) -> Floats:
    """Return the lower bound `[view]` of the noise of a detector, in radians."""
    return np.array([config.least_noise_px / camera.focal for camera in rig.cameras])


def _sample_tracks(recording: Recording, matches: Matches, config: TriangulateConfig) -> Tracks:
    """Return the tracks of an even sample of the labelled frames."""
    frames = evenly_spaced(labelled_frames(matches), config.noise_frames)
    return gather_tracks(recording, matches, frames)


def _medians_of_views(
    rig: CameraRig, measured: Floats, counted: Bools, config: TriangulateConfig
) -> Floats:
    """Return the medians `[view]` of the measured values `[view, N]` that are counted.

    The median of few is not robust: views with few have that of all views together.
    """
    together = np.median(measured[counted]) if counted.any() else config.unknown_noise
    medians = np.full(len(rig), together)
    for view in np.flatnonzero(counted.sum(1) >= LEAST_POINTS):
        medians[view] = np.median(measured[view, counted[view]])
    return np.maximum(medians, least_noise(rig, config))


def _measure_angles(
    rig: CameraRig, rays: Floats, weight: Floats, config: TriangulateConfig
) -> tuple[Floats, Floats, Bools]:
    """Return points `[3, N]`, their angles to the rays `[view, N]`, and which of these count.

    An angle is pi where nothing is seen.
    """
    present = np.asarray(weight > 0)
    points, angle = np.full((3, present.shape[1]), np.nan), np.full(present.shape, np.pi)

    def measure(block: ViewBlock) -> tuple[Floats, Floats]:
        """Return points and angles of a block."""
        own, own_rays = rig.select(block.views), block.take(rays)
        precision = block.take(weight) / config.unknown_noise**2
        points = intersect(own, rays_in_world(own, own_rays), precision)
        return points, ray_angles(own, points, own_rays)[0]

    blocks = view_blocks(present)
    for block, (found, measured) in zip(blocks, map_in_threads(measure, blocks), strict=True):
        points[:, block.points] = found
        block.put(measured, angle)
    enough = present.sum(0) >= min(3, len(rig.cameras))
    return points, angle, present & np.isfinite(points[0]) & enough
