"""The problem of an adjustment: which points of a recording a rig is fitted to, and how."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mocap_calib.adjust.residuals import Residuals, State
from mocap_calib.adjust.solve import Parameters, minimise
from mocap_calib.config import AdjustConfig, Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.geometry.intersection import order_by_views
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import Matches
from mocap_calib.rig import (
    Tracks,
    gather_tracks,
    labelled_frames,
    measure_residuals,
    per_frame_labels,
)
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import POSE, Bools, Camera, CameraRig, Floats, Ints, Recording, Sample


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """A rig, and the points that it is adjusted to.

    rig: where the adjustment starts, with the points `[3, N]` in world coordinates.
    tracks: of the points; weight 1 where a detection agrees on its point, else 0.
    noise: `[view]` standard deviation of a coordinate of the residuals, in radians.
    loss_scale: width of the robust loss at the end, in these.
    """

    rig: CameraRig
    points: Floats
    tracks: Tracks
    noise: Floats
    loss_scale: float

    @cached_property
    def rays(self) -> Residuals:
        """Residuals where the intrinsics are those of the rig."""
        tracks = self.tracks
        return Residuals.of_rays(self.rig.cameras, tracks.rays, self.noise, tracks.weight)

    def pixels(self, cameras: tuple[Camera, ...]) -> Residuals:
        """Return residuals whose intrinsics change from those of some cameras."""
        pixels = np.nan_to_num(self.tracks.pixels)
        sigma = self.noise * [camera.focal for camera in self.rig.cameras]
        return Residuals.of_pixels(cameras, pixels, sigma, self.tracks.weight)

    def start(self, intrinsics: Floats | None = None) -> State:
        """Return the state of the rig; intrinsics: `[view, intrinsic]` changes, None: known."""
        known = np.zeros((len(self.rig), 0))
        given = known if intrinsics is None else intrinsics
        return State(self.rig.rotation, self.rig.translation, self.points, given)

    def at(self, state: State) -> "Problem":
        """Return the problem with the poses and the points of a state."""
        rig = replace(self.rig, rotation=state.rotation, translation=state.translation)
        return replace(self, rig=rig, points=state.points)

    def select(self, points: Ints) -> "Problem":
        """Return the problem of some of the points, given their indices."""
        return replace(self, points=self.points[:, points], tracks=self.tracks.select(points))


def solve(
    start: State,
    seen: Residuals,
    parameters: Parameters,
    config: AdjustConfig,
    *,
    last: float,
    already_close: bool = False,
) -> State:
    """Return the state of least robust cost, under a loss that is tightened in steps.

    Its points have yet to be optimised after the last of them (`solve.optimise_points`).
    last: scale of the loss at the end. already_close: only the last step is needed.
    """
    state, rough = start, config.rough_tolerance
    for scale in () if already_close else config.loss_scales:
        if scale > last:
            state = minimise(state, seen, parameters, loss_scale=scale, tolerance=rough)
    return minimise(state, seen, parameters, loss_scale=last, tolerance=config.tolerance)


# --- which parameters of the cameras are free


def free_poses(views: int) -> Parameters:
    """Return free poses of cameras whose intrinsics are known, see `free_parameters`."""
    return free_parameters(np.arange(views), np.zeros((views, 0)))


def free_parameters(group: Ints, sigma: Floats) -> Parameters:
    """Return free poses and intrinsics.

    The first camera stays where it is: it is the frame of the world.

    group: `[view]` cameras of one number share the changes of their intrinsics; those of -1 have
        none. sigma: `[view, intrinsic]` standard deviation of a change, the same in all views of a
        group.
    """
    views, intrinsics = sigma.shape
    first_free = POSE * (views - 1)
    groups, of_view, sizes = np.unique(group[group >= 0], return_inverse=True, return_counts=True)
    basis = np.zeros((views, POSE + intrinsics, first_free + len(groups) * intrinsics))
    for view in range(1, views):
        basis[view, :POSE, POSE * (view - 1) : POSE * view] = np.eye(POSE)
    precision = 1 / sigma**2
    for view, number in zip(np.flatnonzero(group >= 0).tolist(), of_view.tolist(), strict=True):
        start = first_free + number * intrinsics
        basis[view, POSE:, start : start + intrinsics] = np.eye(intrinsics)
        precision[view] /= sizes[number]
    return Parameters(basis=basis.reshape(-1, basis.shape[2]), precision=precision)


# --- which detections the rig is adjusted to


def choose_problem(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    points: int | None = None,
) -> Problem:
    """Return the problem of evenly spread frames.

    points: how many, about; None: as many as the adjustment needs.

    Raises DegenerateError where there is no match at all, and UnderconstrainedCameraError for the
    camera that has the fewest points, where they are too few to constrain it.
    """
    if matches.individuals == 0:
        raise DegenerateError(
            "",
            "bodies that two views agree on",
            "none",
            "check that the files belong to these cameras and to the same time",
        )
    in_frame = per_frame_labels(matches)  # who it is in other frames does not matter here
    frames = _choose_frames(sample, in_frame, points or config.adjust.points)
    problem = problem_of_frames(sample, rig, in_frame, frames, config)
    _check_every_camera(rig, problem.tracks.used, config.adjust.least_keypoints)
    return problem


def problem_of_frames(
    recording: Recording, rig: CameraRig, matches: Matches, frames: Ints, config: Config
) -> Problem:
    """Return the problem of the points of some frames (`[frame]` indices) that two views agree on.

    The least confident detections of each view are left out: detectors repeat their errors from
    frame to frame, so that these do not average out.
    """
    noise, errors = measure_residuals(recording, rig, matches, config.triangulate)
    tracks = gather_tracks(recording, matches, frames)
    weight = drop_low_confidence(tracks.weight, config.adjust)
    tolerant = replace(config.triangulate, outlier=config.adjust.outlier)
    points, used = triangulate_rays(rig, tracks.rays, weight=weight, noise=noise, config=tolerant)
    known = np.flatnonzero(np.isfinite(points[0]))
    # a block of points that the same views see can leave out the others
    known = known[order_by_views(used[:, known])]
    agreed = replace(tracks, weight=used.astype(np.float64)).select(known)
    points = points[:, known]
    return Problem(
        rig=rig,
        points=points,
        tracks=agreed,
        noise=noise,
        loss_scale=choose_loss_scale(errors, config.adjust.loss_scales[1:]),
    )


def choose_loss_scale(errors: Floats, scales: tuple[float, ...]) -> float:
    """Return the scale under which errors move an estimate least, the last one of no errors.

    errors: `[N]` lengths of vectors in the plane, in standard deviations.

    An estimate errs by the variance E |psi|^2 / (E psi')^2, of the influence psi of an error and
    its slope (Huber 1981: "Robust Statistics", section 3.2). Cauchy's loss has the influence u r,
    where u = 1 / (1 + r^2 / s^2), and over all directions of the vector r the mean slope u^2.
    """
    if not len(errors):
        return scales[-1]
    square = errors**2
    weight = 1 / (1 + square / np.square(scales)[:, None])
    variance = (weight**2 * square).mean(1) / (weight**2).mean(1) ** 2
    return scales[int(variance.argmin())]


def drop_low_confidence(confidence: Floats, config: AdjustConfig) -> Floats:
    """Return the confidence `[view, N]` with 0 for the least confident share of each view.

    confidence: 0 = missing. All are kept where a view has few detections.
    """
    kept = confidence.copy()
    for in_view in kept:
        seen = in_view[in_view > 0]
        if len(seen):
            spare = max(0.0, 1.0 - config.enough_detections / len(seen))
            in_view[in_view < np.quantile(seen, min(config.low_confidence_share, spare))] = 0.0
    return kept


def _choose_frames(sample: Sample, matches: Matches, budget: int) -> Ints:
    """Return indices of frames with matches, evenly spread, of which come about `budget` points."""
    frames = labelled_frames(matches)
    matched = matches.labels[:, frames] >= 0
    detected = sample.seen[:, frames] & matched[..., None]
    views = matched.any(2).sum(0).mean()  # that see a point, about
    points = detected.sum((0, 2, 3)) / max(2.0, views)  # [frame]
    share = min(1.0, budget / max(float(points.sum()), 1.0))
    return evenly_spaced(frames, max(1, round(share * len(frames))))


def _check_every_camera(rig: CameraRig, used: Bools, least: int) -> None:
    """Raise UnderconstrainedCameraError where fewer than `least` keypoints constrain a camera."""
    count = used.sum(1)
    view = int(count.argmin())
    if count[view] < least:
        name = rig.names[view]
        raise UnderconstrainedCameraError(
            f"camera {name}",
            f"at least {least} keypoints that agree with other views",
            count[view],
            "leave it out or record longer",
        )
