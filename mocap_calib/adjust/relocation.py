"""Find where one camera of a calibration stands now, by what the others place."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.camera_fit import CameraFit, CameraPose, Seen, fit_camera
from mocap_calib.adjust.resection import (
    CameraPoses,
    costs_of,
    propose_poses,
    refine_poses,
    sightings_of,
)
from mocap_calib.config import Config
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.placed import PlacedCameras, choose_frames, place_bodies
from mocap_calib.rig.tracks import gather_tracks, labelled_frames
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import CameraRig, Floats, Ints, Sample

_REFINED = 8  # poses that are refined, of those that single detections ask for


def find_lost_camera(
    sample: Sample, placed: PlacedCameras, view: int, config: Config
) -> CameraPose | None:
    """Return where a camera stands whose detections match nobody's, None where nothing tells.

    placed: cameras that place bodies; the labels of the view (index) do not count.
    """
    settings = config.moved
    frames = choose_frames(sample, settings.detections, config)
    bodies = place_bodies(sample, placed, frames, config, without=view)
    seen = sightings_of(sample.rays[view][frames], bodies, settings.least_joints)
    if len(seen.frame) < settings.least_detections:
        return None
    given = CameraPoses(placed.rig.rotation[[view]], placed.rig.translation[[view]])
    poses = given + propose_poses(given, seen, settings)
    widest = settings.loose * float(np.median(seen.angular_size))
    cost = np.nanmean(costs_of(poses, seen, widest, settings.least_joints), axis=1)
    poses = poses[np.argsort(cost, kind="stable")[:_REFINED]]
    poses = refine_poses(
        poses,
        seen,
        counted=np.ones((len(poses), len(seen.frame)), dtype=bool),
        tolerances=tuple(np.geomspace(widest, widest / 10, settings.steps).tolist()),
        least_joints=settings.least_joints,
    )
    cost = costs_of(poses, seen, widest, settings.least_joints)
    best = int(np.nanmean(cost, axis=1).argmin())
    if (cost[best] < settings.explained).mean() < config.verify.least_matched:
        return None
    return CameraPose(poses.rotation[best], poses.translation[best])


@dataclass(frozen=True)
class KnownPoints:
    """Points that some cameras place, and where all cameras saw them.

    points: `[N, 3]` in the world of the rig, NaN = not known. pixels: `[view, N, 2]`, NaN = not
    seen. block: `[N]` the stretch of time of each. keypoint: `[N]` its joint.
    """

    points: Floats
    pixels: Floats
    block: Ints
    keypoint: Ints

    def seen_by(self, view: int, most: int) -> Seen:
        """Return what one view (index) saw of them, at most so many, evenly spread."""
        both = np.isfinite(self.points[:, 0]) & np.isfinite(self.pixels[view, :, 0])
        index = evenly_spaced(np.flatnonzero(both), most)
        whole = Seen(self.points, self.pixels[view], self.block, self.keypoint)
        return whole.select(index)


def place_points(sample: Sample, placed: PlacedCameras, views: Ints, config: Config) -> KnownPoints:
    """Return the points that some views (indices) place, as the rig has these cameras."""
    frames = evenly_spaced(labelled_frames(placed.matches), config.diagnosis.frames)
    seen = gather_tracks(sample, placed.matches, frames)
    weight = np.where(np.isin(np.arange(len(placed.rig)), views)[:, None], seen.weight, 0.0)
    # the rig may be a little off for all: what disagrees by more is wrong
    points, _ = triangulate_rays(
        placed.rig,
        seen.rays,
        weight=weight,
        noise=placed.noise,
        config=replace(config.triangulate, outlier=config.adjust.outlier),
    )
    keypoints, blocks = len(sample.keypoints), config.uncertainty.time_blocks
    rank = np.arange(len(frames)) * blocks // max(len(frames), 1)
    return KnownPoints(
        points=points.T,
        pixels=np.moveaxis(seen.pixels, 1, 2),
        block=np.repeat(rank, points.shape[1] // max(len(frames), 1)),
        keypoint=np.tile(np.arange(keypoints), points.shape[1] // keypoints),
    )


def refit_camera(
    seen: Seen, rig: CameraRig, view: int, *, noise: float, config: Config
) -> tuple[CameraFit, CameraFit]:
    """Return where a camera stands, and the same with its focal length free.

    seen: what the view (index) saw of known points. rig: the search begins where it has the
        camera. noise: of the view, in radians.
    """
    camera = rig.cameras[view]
    start = CameraPose(rig.rotation[view], rig.translation[view])
    sigma = noise * camera.focal
    plain = fit_camera(camera, seen, start, config.diagnosis.fit, noise=sigma)
    free = fit_camera(
        camera, seen, plain.pose, config.diagnosis.fit, noise=sigma, free=("log_focal",)
    )
    return plain, free


def typical_error(known: KnownPoints, rig: CameraRig, view: int, config: Config) -> float:
    """Return the median reprojection error of a view in pixels, NaN where it saw nothing."""
    seen = known.seen_by(view, config.diagnosis.keypoints)
    if not len(seen.points):
        return float("nan")
    in_camera = seen.points @ rig.rotation[view].T + rig.translation[view]
    found = pixels_from_points(rig.cameras[view], in_camera)
    error = np.linalg.norm(found - seen.pixels, axis=1)
    return float(np.median(np.nan_to_num(error, nan=np.inf)))
