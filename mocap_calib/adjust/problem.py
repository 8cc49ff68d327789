"""The problem of an adjustment: which points of a recording a rig is fitted to, and how."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mocap_calib.adjust.parameters import Parameters
from mocap_calib.adjust.residuals import PixelResiduals, RayResiduals, Residuals, State
from mocap_calib.adjust.solve import minimise
from mocap_calib.compute.parallel import do_both
from mocap_calib.config import AdjustConfig, Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.geometry.intersection import median_angles, order_by_views
from mocap_calib.geometry.lens import ray_angles
from mocap_calib.kernels.loading import contiguous
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import Matches
from mocap_calib.rig.labels import per_frame_labels
from mocap_calib.rig.noise import MEDIAN_DISTANCE, view_residual
from mocap_calib.rig.tracks import Tracks, gather_tracks, labelled_frames
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Recording, Sample


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """A rig, and the points that it is adjusted to.

    rig: where the adjustment starts, with the points `[3, N]` in world coordinates.
    tracks: of the points; weight 1 where a detection agrees on its point, else 0.
    noise: `[view]` standard deviation of a coordinate of the residuals, in radians.
    loss_scale: width of the robust loss, in these.
    """

    rig: CameraRig
    points: Floats
    tracks: Tracks
    noise: Floats
    loss_scale: float

    @cached_property
    def rays(self) -> RayResiduals:
        """Residuals where the intrinsics are those of the rig."""
        tracks = self.tracks
        return RayResiduals.of(self.rig.cameras, tracks.rays, self.noise, tracks.weight)

    def pixels(self, cameras: tuple[Camera, ...]) -> PixelResiduals:
        """Return residuals whose intrinsics change from those of some cameras."""
        pixels, weight = contiguous(np.nan_to_num(self.tracks.pixels), self.tracks.weight)
        focal = np.array([camera.focal for camera in self.rig.cameras])
        return PixelResiduals(cameras, pixels, sigma=self.noise * focal, weight=weight)

    def start(self, intrinsics: Floats | None = None) -> State:
        """Return the state of the rig; intrinsics: `[view, intrinsic]` changes, None: known."""
        known = np.zeros((len(self.rig), 0))
        given = known if intrinsics is None else intrinsics
        return State(self.rig.rotation, self.rig.translation, self.points, given)

    def select(self, points: Ints) -> "Problem":
        """Return the problem of some of the points, given their indices."""
        return replace(self, points=self.points[:, points], tracks=self.tracks.select(points))


def solve(
    start: State,
    seen: Residuals,
    parameters: Parameters,
    config: AdjustConfig,
    *,
    loss_scale: float,
    already_close: bool = False,
) -> State:
    """Return the state of least robust cost, under a loss that is tightened in steps.

    Its points have yet to be optimised after the last of them (`solve.optimise_points`).
    loss_scale: of the last step. already_close: only that one is needed.
    """
    state = start
    if not already_close:
        rough = config.rough_tolerance
        for wider in wider_scales(config, loss_scale):
            state = minimise(state, seen, parameters, loss_scale=wider, tolerance=rough)
    return minimise(state, seen, parameters, loss_scale=loss_scale, tolerance=config.tolerance)


def wider_scales(config: AdjustConfig, loss_scale: float) -> tuple[float, ...]:
    """Return the scales of the loss that come before one, in their order."""
    return tuple(scale for scale in config.loss_scales if scale > loss_scale)


# Which detections the rig is adjusted to


def choose_problem(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    points: int | None = None,
    all_detections: bool = False,
) -> Problem:
    """Return the problem of evenly spread frames.

    points: how many, about; None: as many as the adjustment needs. all_detections: none is left
        out for its confidence, as suits a start that is far off.

    Raises DegenerateError where there is no match at all, and UnderconstrainedCameraError for the
    camera that has the fewest points, where they are too few to constrain it.
    """
    if matches.individuals == 0:
        raise DegenerateError(
            "expected bodies that two views agree on, found none; "
            "check that the files belong to these cameras and to the same time"
        )
    in_frame = per_frame_labels(matches)  # who it is in other frames does not matter here
    frames = _choose_frames(sample, in_frame, points or config.adjust.points)
    adjust = replace(config.adjust, low_confidence_share=0.0) if all_detections else config.adjust
    config = replace(config, adjust=adjust)
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
    noise, tracks = do_both(
        lambda: view_residual(recording, rig, matches, config.triangulate),
        lambda: gather_tracks(recording, matches, frames),
    )
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
        loss_scale=_choose_loss_scale(rig, points, agreed.rays, agreed.used, config.adjust),
    )


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


def _choose_loss_scale(
    rig: CameraRig, points: Floats, rays: Floats, used: Bools, config: AdjustConfig
) -> float:
    """Return the width of Cauchy's loss, one of the last two, that gives the least variance.

    points: `[3, N]`; rays: `[view, 3, N]`; used: `[view, N]`.

    With the influence psi = w r of an error r in standard deviations, w = 1 / (1 + r^2 / s^2), the
    variance is E |psi|^2 / (E psi')^2 (Huber 1981: "Robust Statistics", section 3.2). The mean
    slope of psi over all directions of an error in the plane is w^2. Of points that three views
    see (two where there are no more), in multiples of the median that their residuals would have.
    """
    angle = ray_angles(rig, points, rays)[0] / median_angles(rig, points, used.astype(np.float64))
    counted = used & (used.sum(0) >= min(3, len(rig)))
    of_views = [own[seen] for own, seen in zip(angle, counted, strict=True) if seen.any()]
    error = np.concatenate([np.zeros(0), *(own / np.median(own) for own in of_views)])
    error *= MEDIAN_DISTANCE

    def variance(scale: float) -> float:
        """Return the variance under a loss."""
        weight = 1 / (1 + (error / scale) ** 2)
        return float(np.mean((weight * error) ** 2) / np.mean(weight**2) ** 2)

    return min(config.loss_scales[-2:], key=variance) if len(error) else config.loss_scales[-1]


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
            f"camera {name}: expected at least {least} keypoints that agree with other views, "
            f"found {count[view]}; leave it out or record longer",
            name,
        )
