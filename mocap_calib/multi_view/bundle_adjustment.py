"""Bundle adjustment: which detections the rig is built on, and the rig that fits them best."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import AdjustConfig, TriangulateConfig
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.geometry.projection import pixels_from_points
from mocap_calib.multi_view.schur import Sightings, State, minimise
from mocap_calib.multi_view.triangulation import (
    observations,
    per_frame_labels,
    triangulate_rays,
    view_noise,
)
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Matches, Sample

_NUDGE = 1e-4  # radians
_ON_THE_WAY = 1e-3  # a loss that is going to be tightened need not be minimised to the end


@dataclass(frozen=True)
class Points:
    """What is adjusted. points: `[3, N]`; rays: `[view, 3, N]`; weight: `[view, N]` precision; used: `[view, N]`."""

    points: Floats
    rays: Floats
    weight: Floats
    used: Bools


def adjust(
    recording: Sample,
    rig: CameraRig,
    matches: Matches,
    config: AdjustConfig,
    triangulation: TriangulateConfig,
    *,
    already_close: bool = False,
) -> CameraRig:
    """The rig that minimises the robust reprojection error; intrinsics stay, and so do the first camera and the size of the rig.

    The loss is tightened in steps; `already_close` says that the rig has been adjusted before and only the last step is needed.
    Raises LooseCameraError of the camera that has the fewest points, too few to hold it.
    """
    if matches.individuals == 0:
        raise DegenerateError(
            "expected bodies that two views agree on, found none; check that the files belong to these cameras and to the same time"
        )
    matches = per_frame_labels(matches)  # who it is in other frames does not matter here
    noise = view_noise(recording, rig, matches)
    seen = _observations(recording, rig, matches, noise, config, triangulation)
    _check_enough(rig, seen, config.least)
    sightings = _sightings(rig, seen, noise)
    state = State(rig.rotation, rig.translation, seen.points)
    for loss_scale in () if already_close else config.loss_scales[:-1]:
        state = minimise(state, sightings, loss_scale, settled=_ON_THE_WAY)
    state = minimise(state, sightings, config.loss_scales[-1])
    return _of_size(replace(rig, rotation=state.rotation, translation=state.translation), rig)


def _of_size(rig: CameraRig, like: CameraRig) -> CameraRig:
    """The rig at the size of another, the first camera where it was."""
    first = like.centres[0]
    size, wanted = (np.sqrt(((r.centres - first) ** 2).sum()) for r in (rig, like))
    centres = first + (rig.centres - first) * (wanted / size)
    return replace(rig, translation=-np.einsum("vij,vj->vi", rig.rotation, centres))


def _observations(
    recording: Sample,
    rig: CameraRig,
    matches: Matches,
    noise: Floats,
    config: AdjustConfig,
    triangulation: TriangulateConfig,
) -> Points:
    """Points of evenly spread frames, as many as the budget allows, that at least two views agree on."""
    labelled = np.flatnonzero((matches.labels >= 0).any((0, 2)))
    frames = _spread(labelled, recording, matches, config.points)
    found = observations(recording, matches, frames)
    weight = _confident(found.confidence, config)
    # wide: the rig is not yet right, and the loss deals with outliers
    points, used = triangulate_rays(
        rig, found.rays, weight, noise, replace(triangulation, outlier=4 * triangulation.outlier)
    )
    known = np.isfinite(points[0])
    return Points(
        points[:, known], found.rays[..., known], weight[:, known] ** config.trust, used[:, known]
    )


def _confident(weight: Floats, config: AdjustConfig) -> Floats:
    """Takes the least confident share of each view's detections out: detectors are wrong there by more than chance.

    Where detections are few, a doubtful one is better than none.
    """
    out = weight.copy()
    for own in out:
        seen = own[own > 0]
        share = min(config.doubtful, max(0.0, 1.0 - config.enough / max(len(seen), 1)))
        own[own < (np.quantile(seen, share) if len(seen) else 0.0)] = 0.0
    return out


def _spread(labelled: Ints, recording: Sample, matches: Matches, budget: int) -> Ints:
    """An even choice of the frames with matches, so that about `budget` points come of them."""
    instance = matches.labels[:, labelled] >= 0
    joints = (recording.seen[:, labelled] & instance[..., None]).sum((0, 2, 3)) / max(
        2.0, instance.any(2).sum(0).mean()
    )
    share = min(1.0, budget / max(float(joints.sum()), 1.0))
    return evenly_spaced(labelled, max(1, round(share * len(labelled))))


def _check_enough(rig: CameraRig, seen: Points, least: int) -> None:
    count = seen.used.sum(1)
    view = int(count.argmin())
    if count[view] < least:
        found = f"camera {rig.names[view]}: expected at least {least} keypoints that agree with other views, found {count[view]}"
        raise UnderconstrainedCameraError(
            f"{found}; leave it out or record longer", rig.names[view]
        )


def _sightings(rig: CameraRig, seen: Points, noise: Floats) -> Sightings:
    """Residuals in standard deviations of each view's own error, so that the loss means the same in all views."""
    rays = np.where(seen.used[:, None], seen.rays, np.array([0.0, 0.0, 1.0])[:, None])
    metric = np.stack(
        [
            _pixels_per_ray(camera, own.T) / (sigma * camera.focal)
            for camera, own, sigma in zip(rig.cameras, rays, noise, strict=True)
        ]
    )
    metric = np.ascontiguousarray(np.moveaxis(metric, 1, -1))
    return Sightings(
        rays,
        np.where(seen.used[:, None, None], np.nan_to_num(metric), 0.0),
        np.where(seen.used, seen.weight, 0.0),
    )


def _pixels_per_ray(camera: Camera, rays: Floats) -> Floats:
    """`[N, 2, 3]` by how many pixels the image moves when a ray `[N, 3]` turns; along the ray nothing moves."""
    across = np.cross(rays, np.eye(3)[np.abs(rays).argmin(-1)])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    basis = np.stack(
        [across, np.cross(rays, across)], axis=1
    )  # (N, 2, 3) the plane that touches the sphere at the ray
    ends = [
        pixels_from_points(camera, rays[:, None] + sign * _NUDGE * basis) for sign in (1.0, -1.0)
    ]
    slope = (ends[0] - ends[1]) / (2 * _NUDGE)  # (N, 2 of the basis, 2 of the image)
    return np.einsum("nbi,nbk->nik", slope, basis)
