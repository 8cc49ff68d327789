"""Stage 5: bundle adjustment by Ceres; the one user of pycolmap.

One static image per camera; each (frame, individual, keypoint) is one 3D point. COLMAP puts the pixel's corner at an
integer, we its centre: half a pixel is added here and nowhere else. Every image is scaled so that its usual error is
one, so that the robust loss means the same in all views.
"""

from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from mocap_calib.config import AdjustConfig, TriangulateConfig
from mocap_calib.errors import DegenerateError, MismatchError
from mocap_calib.triangulation import by_individual, triangulate_rays, view_noise
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Matches, Recording

pycolmap.logging.minloglevel = 3


@dataclass(frozen=True)
class Observations:
    """What is adjusted. points: `[N, 3]`; positions: `[view, N, 2]` pixels; used: `[view, N]`."""

    points: Floats
    positions: Floats
    used: Bools


def adjust(recording: Recording, rig: CameraRig, matches: Matches, config: AdjustConfig, triangulation: TriangulateConfig, *, near: bool = False) -> CameraRig:
    """The rig that minimises the robust reprojection error; intrinsics stay, and so does the gauge (two cameras' worth).

    The loss is tightened in steps; `near` says that the rig has been adjusted before and only the last step is needed.
    Raises DegenerateError where a camera has too few points to hold it.
    """
    if matches.individuals == 0:
        raise DegenerateError("expected bodies that two views agree on, found none; check that the files belong to these cameras and to the same time")
    noise = view_noise(recording, rig, matches)
    seen = _observations(recording, rig, matches, noise, config, triangulation)
    _check_enough(rig, seen)
    scale = np.array([1.0 / (sigma * camera.focal) for sigma, camera in zip(noise, rig.cameras, strict=True)])
    model = _reconstruction(rig, seen, scale)
    for loss_scale in config.loss_scales[-1:] if near else config.loss_scales:
        _solve(model, len(rig.cameras), loss_scale)
    found = [model.image(k + 1).cam_from_world() for k in range(len(rig.cameras))]
    # contiguous: another memory layout is another order of summation, and other last digits downstream
    rotation = np.ascontiguousarray([f.rotation.matrix() for f in found])
    return replace(rig, rotation=rotation, translation=np.ascontiguousarray([f.translation for f in found]) + 0.0)


def _observations(
    recording: Recording, rig: CameraRig, matches: Matches, noise: Floats, config: AdjustConfig, triangulation: TriangulateConfig
) -> Observations:
    """Points of evenly spread frames, as many as the budget allows, that at least two views agree on."""
    labelled = np.flatnonzero((matches.labels >= 0).any((0, 2)))
    frames = _spread(labelled, recording, matches, config.points)
    rays, positions, weight = by_individual(recording, matches, frames)
    weight = _confident(weight, config.doubtful)
    views = len(rays)
    rays, positions, weight = rays.reshape(views, -1, 3), positions.reshape(views, -1, 2), weight.reshape(views, -1)
    # wide: the rig is not yet right, and the loss deals with outliers
    points, used = triangulate_rays(rig, rays, weight, noise, replace(triangulation, outlier=4 * triangulation.outlier))
    known = np.isfinite(points[:, 0])
    return Observations(points[known], positions[:, known], used[:, known])


def _confident(weight: Floats, doubtful: float) -> Floats:
    """Takes the least confident share of each view's detections out: detectors are wrong there by more than chance."""
    out = weight.copy()
    for own in out:
        seen = own[own > 0]
        own[own < (np.quantile(seen, doubtful) if len(seen) else 0.0)] = 0.0
    return out


def _spread(labelled: Ints, recording: Recording, matches: Matches, budget: int) -> Ints:
    """An even choice of the frames with matches, so that about `budget` points come of them."""
    instance = matches.labels[:, labelled] >= 0
    joints = (recording.seen[:, labelled] & instance[..., None]).sum((0, 2, 3)) / max(2.0, instance.any(2).sum(0).mean())
    share = min(1.0, budget / max(float(joints.sum()), 1.0))
    return labelled[np.linspace(0, len(labelled) - 1, max(1, round(share * len(labelled)))).astype(int)]


def _check_enough(rig: CameraRig, seen: Observations) -> None:
    poor = [camera.name for camera, used in zip(rig.cameras, seen.used, strict=True) if used.sum() < 20]
    if poor:
        raise DegenerateError(
            f"camera {', '.join(poor)}: expected at least 20 keypoints that agree with other views, found fewer; leave it out or record longer"
        )


def _camera(camera: Camera, number: int, scale: float) -> pycolmap.Camera:
    """A camera of an image enlarged by `scale`. COLMAP: cx = scale * (cx + 0.5)."""
    matrix, k = camera.matrix, camera.distortion
    lens = [*matrix[[0, 1], [0, 1]] * scale, *(matrix[[0, 1], [2, 2]] + 0.5) * scale]
    if camera.fisheye:
        model, params = "OPENCV_FISHEYE", [*lens, *np.pad(k, (0, 4))[:4]]
    else:
        if np.any(k[8:] != 0):
            raise MismatchError(f"camera {camera.name}: expected at most 8 distortion coefficients, found thin-prism or tilt terms; recalibrate without them")
        model, params = "FULL_OPENCV", [*lens, *np.pad(k[:8], (0, 8 - len(k[:8])))]
    width, height = (max(1, round(side * scale)) for side in camera.size)
    return pycolmap.Camera(camera_id=number, model=model, width=width, height=height, params=params)


def _reconstruction(rig: CameraRig, seen: Observations, scale: Floats) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    index = np.where(seen.used, np.cumsum(seen.used, axis=1) - 1, -1)
    for view, camera in enumerate(rig.cameras):
        number = view + 1
        model.add_camera_with_trivial_rig(_camera(camera, number, scale[view]))
        points = (seen.positions[view, seen.used[view]] + 0.5) * scale[view]
        image = pycolmap.Image(name=camera.name, keypoints=points, camera_id=number, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rig.rotation[view]), rig.translation[view])
        model.add_image_with_trivial_frame(image, pose)
    for n, point in enumerate(seen.points):
        track = pycolmap.Track()
        for view in np.flatnonzero(seen.used[:, n]).tolist():
            track.add_element(view + 1, int(index[view, n]))
        model.add_point3D(point, track)
    return model


def _solve(model: pycolmap.Reconstruction, views: int, loss_scale: float) -> None:
    setup = pycolmap.BundleAdjustmentConfig()
    for number in range(1, views + 1):
        setup.add_image(number)
        setup.set_constant_cam_intrinsics(number)
    setup.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = loss_scale
    options.ceres.solver_options.num_threads = 1  # two are slower here, and one is reproducible
    options.ceres.solver_options.max_num_iterations = 50
    options.ceres.solver_options.function_tolerance = 1e-6
    pycolmap.create_default_ceres_bundle_adjuster(options, setup, model).solve()
