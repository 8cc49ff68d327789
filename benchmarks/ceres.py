"""Bundle adjustment by Ceres through pycolmap: an independent second opinion on a rig.

The same points, detections and loss as in `refine.adjust_once`; another solver (Ceres) of other
residuals (pixels through COLMAP's lens models, where ours are taken at the rays).
"""

from dataclasses import replace

import numpy as np
import pycolmap

from mocap_calib.adjust.problem import Problem, choose_problem
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import CORNER_OFFSET, Config
from mocap_calib.geometry.rotation import with_size_of
from mocap_calib.io.formats.colmap import build_model, silent_colmap
from mocap_calib.results import Matches, ObservedPoints
from mocap_calib.types import Camera, CameraRig, Floats, Sample

_STEPS = 100  # at most


@single_threaded_libraries()
def adjust_by_ceres(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    already_close: bool = False,
) -> CameraRig:
    """Return the rig that minimises the robust reprojection error of the matched detections.

    Takes, keeps and raises what `refine.adjust_once` does. All detections count the same.
    """
    problem = choose_problem(sample, rig, matches, config)
    model = _build_model(problem)
    if not already_close:
        for wider in config.adjust.loss_scales[:-1]:
            _solve(model, loss_scale=wider, tolerance=config.adjust.rough_tolerance)
    _solve(model, loss_scale=problem.loss_scale, tolerance=config.adjust.tolerance)
    poses = [model.image(view + 1).cam_from_world() for view in range(len(rig.cameras))]
    adjusted = replace(
        rig,
        # in numpy's own order of memory, on which the last digits of sums depend
        rotation=np.ascontiguousarray([pose.rotation.matrix() for pose in poses]),
        translation=np.ascontiguousarray([pose.translation for pose in poses]),
    )
    return with_size_of(rig, adjusted)


def _build_model(problem: Problem) -> pycolmap.Reconstruction:
    """Return the model of the points, its images resized so that the usual error is 1 in all.

    COLMAP has one loss for all images, and ours is in standard deviations of each view.
    """
    rig, tracks = problem.rig, problem.tracks
    focal = np.array([camera.focal for camera in rig.cameras])
    scale = 1 / (problem.noise * focal)
    cameras = [_resize(camera, size) for camera, size in zip(rig.cameras, scale, strict=True)]
    view, point = np.nonzero(tracks.used)
    pixels = _resize_pixels(tracks.pixels[view, :, point], scale[view, None])
    observed = ObservedPoints(problem.points.T, view, point, pixels)
    return build_model(replace(rig, cameras=tuple(cameras)), observed)


def _resize(camera: Camera, scale: float) -> Camera:
    """Return the camera of an image that was made `scale` times as large."""
    matrix = camera.matrix.copy()
    matrix[:2] *= scale
    matrix[:2, 2] = _resize_pixels(camera.matrix[:2, 2], scale)
    width, height = (max(1, round(side * scale)) for side in camera.size)
    return replace(camera, matrix=matrix, size=(width, height))


def _resize_pixels(pixels: Floats, scale: float | Floats) -> Floats:
    """Return where pixels are in an image `scale` times as large: its corner stays, at -1/2."""
    return (pixels + CORNER_OFFSET) * scale - CORNER_OFFSET


def _solve(model: pycolmap.Reconstruction, *, loss_scale: float, tolerance: float) -> None:
    """Move the cameras but the first, and the points, to the least robust cost (Cauchy's loss)."""
    problem = pycolmap.BundleAdjustmentConfig()
    for number in model.images:
        problem.add_image(number)
        problem.set_constant_cam_intrinsics(number)
    problem.set_constant_rig_from_world_pose(1)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = loss_scale
    options.ceres.solver_options.num_threads = 1  # so that the same input gives the same digits
    options.ceres.solver_options.max_num_iterations = _STEPS
    options.ceres.solver_options.function_tolerance = tolerance
    with silent_colmap():
        pycolmap.create_default_ceres_bundle_adjuster(options, problem, model).solve()
