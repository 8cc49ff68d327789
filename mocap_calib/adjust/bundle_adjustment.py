"""Bundle adjustment: choose the detections that the rig is built on, and fit the rig to them."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.freedom import Freedom, free_poses
from mocap_calib.adjust.ray_residuals import RayObservations
from mocap_calib.adjust.residuals import Observations, State
from mocap_calib.adjust.schur import minimise
from mocap_calib.compute.parallel import do_both, map_in_threads, single_threaded_libraries
from mocap_calib.config import AdjustConfig, Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.geometry.lens import image_slopes
from mocap_calib.geometry.point_covariance import median_angles
from mocap_calib.geometry.rays import ray_angles
from mocap_calib.geometry.view_blocks import order_by_views
from mocap_calib.kernels.loading import contiguous
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.labels import per_frame_labels
from mocap_calib.rig.noise import MEDIAN_DISTANCE, view_residual
from mocap_calib.rig.tracks import gather_tracks, labelled_frames
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import (
    Bools,
    Camera,
    CameraRig,
    Floats,
    Ints,
    Matches,
    Recording,
    Sample,
)


@dataclass(frozen=True)
class AdjustablePoints:
    """The points that are adjusted, and what is seen of them.

    points: `[3, N]` in world coordinates.
    frame, individual, keypoint: `[N]` indices of what each is of.
    pixels: `[view, 2, N]`, NaN = missing.
    rays: `[view, 3, N]` unit vectors in each camera's frame, NaN = missing.
    weight: `[view, N]`, what a detection counts for; 0 where it does not agree on the point.
    noise: `[view]` standard deviation of a coordinate, in radians.
    loss_scale: width of the robust loss, in these.
    """

    points: Floats
    frame: Ints
    individual: Ints
    keypoint: Ints
    pixels: Floats
    rays: Floats
    weight: Floats
    noise: Floats
    loss_scale: float

    @property
    def used(self) -> Bools:
        """`[view, N]` the detections that agree on the point."""
        return np.asarray(self.weight > 0)

    def select(self, points: Ints) -> "AdjustablePoints":
        """Return some of the points, given their indices."""
        return AdjustablePoints(
            points=self.points[:, points],
            frame=self.frame[points],
            individual=self.individual[points],
            keypoint=self.keypoint[points],
            pixels=self.pixels[..., points],
            rays=self.rays[..., points],
            weight=self.weight[:, points],
            noise=self.noise,
            loss_scale=self.loss_scale,
        )

    def time_blocks(self, blocks: int) -> Ints:
        """Return the stretch of the recording `[N]` that each point belongs to, of so many."""
        frames, rank = np.unique(self.frame, return_inverse=True)
        return np.asarray(rank * blocks // len(frames), dtype=np.int64)


def adjust(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> CameraRig:
    """Return the rig that minimises the robust reprojection error of the matched detections.

    Intrinsics stay as they are, and so do the first camera and the size of the rig. It is adjusted
    twice: the loss is in standard deviations of the errors, and how large these are is known only
    of a rig that is close.

    Raises UnderconstrainedCameraError for the camera that has the fewest points, where they are
    too few to constrain it, and DegenerateError where there is no match at all.
    """
    close = adjust_once(sample, rig, matches, config)
    return adjust_once(sample, close, matches, config, already_close=True)


@single_threaded_libraries()
def adjust_once(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    already_close: bool = False,
) -> CameraRig:
    """Return what `adjust` does, by the errors that the rig has to begin with.

    The loss is tightened in steps. already_close: the rig has been adjusted before, so that only
    the last step is needed.
    """
    points = choose_points(sample, rig, matches, config)
    start = State(rig.rotation, rig.translation, points.points, np.zeros((len(rig.cameras), 0)))
    seen = observe_rays(rig, points)
    freedom = free_poses(len(rig.cameras))
    found = minimise_in_steps(
        start,
        seen,
        freedom,
        config.adjust,
        loss_scale=points.loss_scale,
        already_close=already_close,
    )
    return placed_as(rig, found)


def choose_points(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> AdjustablePoints:
    """Return points of evenly spread frames that at least two views agree on.

    As many as the budget allows. Raises as `adjust` does.
    """
    if matches.individuals == 0:
        raise DegenerateError(
            "expected bodies that two views agree on, found none; "
            "check that the files belong to these cameras and to the same time"
        )
    in_frame = per_frame_labels(matches)  # who it is in other frames does not matter here
    frames = _choose_frames(sample, in_frame, config.adjust.points)
    points = agreed_points(sample, rig, in_frame, frames, config)
    _check_every_camera(rig, points, config.adjust.least_keypoints)
    return points


def minimise_in_steps(
    state: State,
    seen: Observations,
    freedom: Freedom,
    config: AdjustConfig,
    *,
    loss_scale: float,
    already_close: bool = False,
) -> State:
    """Return the state of least robust cost, under a loss that is tightened in steps.

    Its points have yet to settle after the last of them (`schur.settle_points`).
    loss_scale: of the last step. already_close: only that one is needed.
    """
    if not already_close:
        rough = config.rough_tolerance
        for wider in wider_scales(config, loss_scale):
            state = minimise(state, seen, freedom, loss_scale=wider, tolerance=rough)
    return minimise(state, seen, freedom, loss_scale=loss_scale, tolerance=config.tolerance)


def wider_scales(config: AdjustConfig, loss_scale: float) -> tuple[float, ...]:
    """Return the scales of the loss that come before one, in their order."""
    return tuple(scale for scale in config.loss_scales if scale > loss_scale)


def placed_as(rig: CameraRig, state: State) -> CameraRig:
    """Return the rig with its cameras where a state has them, at the size that it has."""
    adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
    return with_size_of(rig, adjusted)


def with_size_of(reference: CameraRig, rig: CameraRig) -> CameraRig:
    """Return the rig at the size of a reference, the first camera where the reference has it."""
    first = reference.centres[0]
    size = np.sqrt(((rig.centres - first) ** 2).sum())
    reference_size = np.sqrt(((reference.centres - first) ** 2).sum())
    centres = first + (rig.centres - first) * (reference_size / size)
    return rig.stand(rig.rotation, centres)


# Which detections the rig is built on


def agreed_points(
    recording: Recording, rig: CameraRig, matches: Matches, frames: Ints, config: Config
) -> AdjustablePoints:
    """Return the points of frames (`[frame]` indices) that at least two views agree on.

    The least confident detections of each view are left out: detectors repeat their errors from
    frame to frame, so that these do not average out.
    """
    noise, seen = do_both(
        lambda: view_residual(recording, rig, matches, config.triangulate),
        lambda: gather_tracks(recording, matches, frames),
    )
    weight = drop_low_confidence(seen.weight, config.adjust)
    outlier = config.adjust.outlier_tolerance * config.triangulate.outlier
    tolerant = replace(config.triangulate, outlier=outlier)
    points, used = triangulate_rays(rig, seen.rays, weight=weight, noise=noise, config=tolerant)
    known = np.flatnonzero(np.isfinite(points[0]))
    # a block of points that the same views see can leave out the others
    known = known[order_by_views(used[:, known])]
    shape = (len(frames), matches.individuals, len(recording.keypoints))
    frame, individual, keypoint = np.unravel_index(known, shape)
    return AdjustablePoints(
        points=points[:, known],
        frame=frames[frame],
        individual=individual,
        keypoint=keypoint,
        pixels=seen.pixels[..., known],
        rays=seen.rays[..., known],
        weight=np.where(used[:, known], 1.0, 0.0),
        noise=noise,
        loss_scale=choose_loss_scale(rig, points, seen.rays, used, config.adjust),
    )


def choose_loss_scale(
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


def _check_every_camera(rig: CameraRig, points: AdjustablePoints, least: int) -> None:
    """Raise UnderconstrainedCameraError where fewer than `least` keypoints constrain a camera."""
    count = points.used.sum(1)
    view = int(count.argmin())
    if count[view] < least:
        name = rig.names[view]
        raise UnderconstrainedCameraError(
            f"camera {name}: expected at least {least} keypoints that agree with other views, "
            f"found {count[view]}; leave it out or record longer",
            name,
        )


# Residuals


def observe_rays(rig: CameraRig, points: AdjustablePoints) -> RayObservations:
    """Return what was seen, with the metric that turns directions into residuals.

    Residuals are in standard deviations of each view's own error, so that the loss means the same
    in all views.
    """
    axis = np.array([0.0, 0.0, 1.0])[:, None]
    used = points.used
    rays = np.where(used[:, None], points.rays, axis)
    metric = np.empty((len(rays), 2, *rays.shape[1:]))

    def measure(view: int) -> None:
        """Set the metric of a view."""
        camera = rig.cameras[view]
        slopes = _pixels_per_ray(camera, rays[view]) / (points.noise[view] * camera.focal)
        metric[view] = np.where(used[view], np.nan_to_num(slopes), 0.0)

    list(map_in_threads(measure, range(len(rays))))
    return RayObservations(*contiguous(rays, metric, points.weight))


def _pixels_per_ray(camera: Camera, rays: Floats) -> Floats:
    """Return by how many pixels the image moves when rays turn, `[2, 3, N]`.

    rays: `[3, N]` in the camera's frame; along the ray nothing moves. NaN behind the camera.
    """
    depth = np.where(rays[2] > 1e-9, rays[2], np.nan)
    image = rays[:2] / depth
    slopes = image_slopes(camera, image).image / depth
    along = np.einsum("kin,in->kn", slopes, image)
    return np.concatenate([slopes, -along[:, None]], axis=1)
