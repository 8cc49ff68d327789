"""Which cameras deserve a closer look: cheap signs, none of which is proof."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.adjust.camera_fit import CameraPose, Seen, Unknown, fit_camera
from mocap_calib.config import Config, DiagnosisConfig
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.recording.corrections import exchanged_sides
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import CalibrationResult, Matches
from mocap_calib.rig.observed import Observed
from mocap_calib.rig.tracks import (
    Tracks,
    gather_tracks,
    labelled_frames,
    view_noise,
)
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import Bools, CameraRig, Floats, Sample

_LEAST_PAIRED = 4  # keypoints of a detection that tell whether its sides are exchanged
_CLEARLY = 0.5  # of the error as given
_FREE: tuple[Unknown, ...] = ("log_focal", "x", "y")


@dataclass(frozen=True)
class Signs:
    """What makes cameras suspicious, `[view]` each.

    apart: the camera is not in the largest group. pairs: score of its pairs, as a share of that of
    the others' pairs. outside: share of its keypoints outside its images. roll: in degrees,
    against the other cameras of its group; NaN where they do not agree on which way is down.
    errors: of its keypoints, as a multiple of those of the others.
    exchanged: share of its detections that fit far better with left and right exchanged.
    intrinsics: Wald's statistic of other intrinsics, where these differ by much.
    """

    apart: Bools
    pairs: Floats
    outside: Floats
    roll: Floats
    errors: Floats
    exchanged: Floats
    intrinsics: Floats

    def suspicious(self, config: DiagnosisConfig) -> Bools:
        """Return `[view]` whether a camera deserves a closer look.

        Where half of the cameras are apart, either half may be the odd one.
        """
        halves = 2 * self.apart.sum() >= len(self.apart)
        return (
            self.apart
            | halves
            | (self.pairs < config.suspicious_pairs)
            | (self.outside > config.suspicious_outside)
            | (self.errors > config.suspicious_errors)
            | (self.exchanged > config.suspicious_exchanged)
            | (self.intrinsics > config.crop_significance)
            | is_turned(self.roll, config)
        )


def is_turned(roll: Floats, config: DiagnosisConfig) -> Bools:
    """Return where a roll (degrees) is a quarter, a half or three quarters of a turn."""
    quarters = np.round(np.nan_to_num(roll) / 90)
    near = np.abs(np.nan_to_num(roll) - 90 * quarters) < config.roll_deg
    return np.asarray(near & (quarters % 4 != 0))


def find_signs(observed: Observed, result: CalibrationResult, config: Config) -> Signs:
    """Return what makes the cameras of a recording suspicious."""
    names = observed.recording.names
    views = len(names)
    group = result.groups[0]
    members = np.array([names.index(name) for name in group.rig.names])
    apart = np.ones(views, dtype=bool)
    apart[members] = False
    signs = Signs(
        apart=apart,
        pairs=_pair_scores(observed),
        outside=_share_outside(observed),
        roll=np.full(views, np.nan),
        errors=np.zeros(views),
        exchanged=np.zeros(views),
        intrinsics=np.zeros(views),
    )
    if len(members) < 3:
        return signs
    sample = observed.sample.select(views=members)
    matches = group.adjusted.matches
    signs.roll[members] = rolls(group.rig, config.diagnosis)
    errors, exchanged, intrinsics = _hold_against_others(sample, group.rig, matches, config)
    signs.errors[members], signs.exchanged[members] = errors, exchanged
    signs.intrinsics[members] = intrinsics
    return signs


def _pair_scores(observed: Observed) -> Floats:
    """Return the mean score `[view]` of a camera's pairs, as a share of that of the other pairs."""
    scores = np.array([pair.score for pair in observed.pairs])
    ends = np.array([(pair.a, pair.b) for pair in observed.pairs]).reshape(-1, 2)
    found = np.ones(len(observed.recording.cameras))
    for view in range(len(found)):
        own = (ends == view).any(1)
        if own.any() and not own.all():
            found[view] = scores[own].mean() / max(float(scores[~own].mean()), 1e-9)
    return found


def _share_outside(observed: Observed) -> Floats:
    """Return the share `[view]` of the keypoints that lie outside the image."""
    found = []
    for camera, pixels in zip(observed.sample.cameras, observed.sample.positions, strict=True):
        size = np.array(camera.size, dtype=np.float64)
        seen = pixels[np.isfinite(pixels[..., 0])]
        outside = (seen < -1).any(-1) | (seen > size + 1).any(-1)
        found.append(float(outside.mean()) if len(seen) and size.all() else 0.0)
    return np.array(found)


def rolls(rig: CameraRig, config: DiagnosisConfig) -> Floats:
    """Return how far each camera is turned clockwise about its axis, `[view]` in degrees.

    Against the down of the others' images, which must agree among themselves; NaN where they do
    not, or where the camera looks up or down.
    """
    views = len(rig)
    found = np.full(views, np.nan)
    for view in range(views):
        others = np.delete(np.arange(views), view)
        down = rig.rotation[others, 1].mean(0)
        among = [_roll(rig.rotation[other], down) for other in others]
        if len(others) >= 2 and all(abs(roll) < config.upright_deg for roll in among):
            found[view] = _roll(rig.rotation[view], down)
    return found


def _roll(rotation: Floats, down: Floats) -> float:
    """Return the angle in degrees from an image's y to a direction `[3]` of the world, clockwise.

    NaN where the camera looks nearly along it.
    """
    x, y, z = rotation @ down
    if np.hypot(x, y) < np.abs(z):
        return np.nan
    return float(np.degrees(np.arctan2(-x, y)))


def _hold_against_others(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> tuple[Floats, Floats, Floats]:
    """Return the errors, the exchanged share and the statistic of intrinsics of each camera.

    Each camera is held against the points that the others know by the rig as it is.
    """
    diagnosis = config.diagnosis
    # a frame of a large rig tells more and takes longer: each camera is held against all others
    large = max(1.0, len(rig) / config.view_graph.small_rig) ** 2
    count = max(round(diagnosis.suspicious_frames / large), diagnosis.suspicious_least_frames)
    frames = evenly_spaced(labelled_frames(matches), count)
    noise = view_noise(sample, rig, matches, config.triangulate)
    seen = gather_tracks(sample, matches, frames)
    views = len(rig)
    angles, significance = np.full(views, np.nan), np.zeros(views)
    exchanged = np.zeros(views)
    keypoints = len(sample.keypoints)
    for view, camera in enumerate(rig.cameras):
        others = np.where(_detections_of(seen, view, keypoints), seen.weight, 0.0)
        others[view] = 0.0
        points, _ = triangulate_rays(
            rig, seen.rays, weight=others, noise=noise, config=config.triangulate
        )
        both = np.flatnonzero(np.isfinite(points[0]) & np.isfinite(seen.pixels[view, 0]))
        if len(both) < diagnosis.least_keypoints:
            continue
        exchanged[view] = _exchanged_share(rig, view, points, seen.pixels[view], sample.keypoints)
        both = evenly_spaced(both, diagnosis.suspicious_keypoints)
        known = Seen(
            points=points[:, both].T,
            pixels=seen.pixels[view][:, both].T,
            block=both * diagnosis.time_blocks // points.shape[1],
            keypoint=both % keypoints,
        )
        start = CameraPose(rig.rotation[view], rig.translation[view])
        rough = diagnosis.focal_noise * camera.focal
        fit = fit_camera(camera, known, start, diagnosis.fit, noise=rough, free=_FREE)
        angles[view] = np.median(_fit_error(rig, view, known)) / camera.focal
        size = np.array(camera.size) if all(camera.size) else np.full(2, 2 * camera.focal)
        much = abs(fit.unknowns[0]) > diagnosis.least_focal_change
        much |= bool((np.abs(fit.unknowns[1:]) > diagnosis.least_crop * size).any())
        significance[view] = fit.significance if much else 0.0
    others_angle = np.array([_median_of_known(np.delete(angles, v)) for v in range(views)])
    return np.nan_to_num(angles / others_angle, nan=np.inf), exchanged, significance


def _detections_of(seen: Tracks, view: int, keypoints: int) -> Bools:
    """Return `[N]` whether a view sees anything of the body that each point is of."""
    bodies = np.isfinite(seen.pixels[view, 0]).reshape(-1, keypoints).any(1)
    return np.repeat(bodies, keypoints)


def _exchanged_share(
    rig: CameraRig, view: int, points: Floats, pixels: Floats, keypoints: tuple[str, ...]
) -> float:
    """Return the share of a camera's detections that fit far better with sides exchanged.

    points: `[3, N]`; pixels: `[2, N]`, N = detections x keypoints.
    """
    order = exchanged_sides(keypoints)
    paired = order != np.arange(len(order))
    if not paired.any():
        return 0.0
    in_camera = points.T @ rig.rotation[view].T + rig.translation[view]
    image = pixels_from_points(rig.cameras[view], in_camera).reshape(-1, len(order), 2)
    given = pixels.T.reshape(-1, len(order), 2)
    errors = [np.linalg.norm(image - seen, axis=-1)[:, paired] for seen in (given, given[:, order])]
    both = np.isfinite(errors[0]) & np.isfinite(errors[1])
    count = both.sum(1)
    mean = [np.where(both, error, 0.0).sum(1) / np.maximum(count, 1) for error in errors]
    told = count >= _LEAST_PAIRED
    return float((mean[1] < _CLEARLY * mean[0])[told].mean()) if told.any() else 0.0


def _fit_error(rig: CameraRig, view: int, known: Seen) -> Floats:
    """Return the distances `[N]` in pixels of points from where a camera of the rig saw them."""
    in_camera = known.points @ rig.rotation[view].T + rig.translation[view]
    error = np.linalg.norm(pixels_from_points(rig.cameras[view], in_camera) - known.pixels, axis=1)
    return np.nan_to_num(error, nan=np.inf)


def _median_of_known(values: Floats) -> float:
    """Return the median of the values that are not NaN, NaN where there is none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan
