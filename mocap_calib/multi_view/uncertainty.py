"""Whether the rig is determined by what was seen, and all cameras agree on it.

Reprojection errors are small also where nothing is determined: a subject that stands still, small in the image, leaves errors of its
joints (of the detector, of the lens model) that all frames share, and the rig bends to fit them. Two halves of the joints share the
cameras but not these errors: the rig is adjusted on each, and the angle between the two is an estimate of its error. One split
may agree by chance, so several are made.

What the halves share they do not show: a camera out of step, moved, or with another's intrinsics. Its own errors do, which are several
times those of the others.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from mocap_calib.compute.parallel import in_order
from mocap_calib.config import Config, TriangulateConfig
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.multi_view.bundle_adjustment import adjust
from mocap_calib.multi_view.triangulation import observations, project, triangulate_rays, view_noise
from mocap_calib.types import Bools, CameraRig, Floats, Matches, Sample, Uncertainty

Verdict = Literal["well determined", "weak", "not determined"]
_WELL_DEG, _WEAK_DEG = (
    4.0,
    10.0,
)  # between halves, which differ by twice the error of the whole: 2 and 5 deg of the rig
_SPLITS = 4
_SEVERAL = 4.0  # times the errors of the others: 1 to 2.6 in recordings whose cameras agree, 3.8 between telescopes, 5 to 18 out of step
_FAR = 4.0  # usual errors
_ALIKE = 1.05  # misfits of two rigs that the observations do not tell apart


@dataclass(frozen=True)
class Fit:
    """How a rig fits what was seen, in pixels.

    misfit: RMS distance of all detections from their reprojections, none counted as farther than four usual ones. angle: `[view]` their
    median, in radians. noise: `[view]` robust standard deviation of a coordinate. perspective: `[view]` RMS of what no affine camera could explain:
    where it is far below the noise, the view might as well be infinitely far away, and how far it is follows from its focal length alone.
    """

    misfit: float
    angle: Floats
    noise: Floats
    perspective: Floats


def assess_uncertainty(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, *, seed: int
) -> Uncertainty:
    """Return how well the rig is determined by the sample, and which cameras stand out."""
    fit = measure_fit(sample, rig, matches, config.triangulate)
    return Uncertainty(
        split_half_angle=split_half_angle(sample, rig, matches, config, seed=seed),
        outlier_cameras=outlier_cameras(fit),
        weak_perspective=weak_perspective(fit),
    )


def split_half_angle(
    recording: Sample, rig: CameraRig, matches: Matches, config: Config, *, seed: int
) -> Floats:
    """`[pair]` radians between the relative rotations of two rigs, each adjusted on half of the joints; RMS over several splits.

    pi where a half does not hold one of the two cameras.
    """

    def work(half: Sample) -> Floats:
        return _rotations(half, rig, matches, config)

    halves = np.stack(list(in_order(work, _halves(recording, seed))))
    a, b = np.array(list(combinations(range(len(rig.cameras)), 2))).T
    between = halves[:, b] @ np.swapaxes(halves[:, a], -1, -2)
    angle = np.nan_to_num(angle_between(between[::2], between[1::2]), nan=np.pi)
    return np.sqrt((angle**2).mean(0))


def _rotations(half: Sample, rig: CameraRig, matches: Matches, config: Config) -> Floats:
    """`[view, 3, 3]` of the rig adjusted on a part of what was seen; NaN of cameras that the part does not hold."""
    found = np.full_like(rig.rotation, np.nan)
    fewer = replace(
        config.adjust, points=config.adjust.points // _SPLITS
    )  # joints differ by more than chance: more frames do not show it better
    held = np.arange(len(rig.cameras))
    while len(held) >= 2:
        labels = Matches(matches.labels[held])
        try:
            found[held] = adjust(
                half.select(views=held),
                rig.select(held),
                labels,
                fewer,
                config.triangulate,
                already_close=True,
            ).rotation
            break
        except UnderconstrainedCameraError as loose:
            held = np.array([v for v in held if rig.names[v] != loose.camera])
        except DegenerateError:
            break
    return found


def verdict(split_half_angle: Floats, outlier_cameras: Bools) -> Verdict:
    """What the split-half angle `[pair]` means for the camera that is worst off, by its median; none is well determined where a camera contradicts."""
    a, b = np.array(list(combinations(range(len(outlier_cameras)), 2))).T
    worst = max(
        float(np.median(split_half_angle[(a == view) | (b == view)]))
        for view in range(len(outlier_cameras))
    )
    if np.rad2deg(worst) > _WEAK_DEG or 2 * outlier_cameras.sum() > len(outlier_cameras):
        return "not determined"
    return "weak" if np.rad2deg(worst) > _WELL_DEG or outlier_cameras.any() else "well determined"


def measure_fit(
    recording: Sample, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Fit:
    """Of all frames of the sample."""
    seen = observations(recording, matches, np.flatnonzero((matches.labels >= 0).any((0, 2))))
    noise = view_noise(recording, rig, matches)
    # wide: what does not fit is to be counted, not left out
    points, _ = triangulate_rays(
        rig, seen.rays, seen.confidence, noise, replace(config, outlier=np.inf)
    )
    images = [
        project(camera, rig.rotation[v], rig.translation[v], points)
        for v, camera in enumerate(rig.cameras)
    ]
    there = (seen.confidence > 0) & np.isfinite(points[0])
    error = np.linalg.norm(np.stack(images) - seen.pixels, axis=1)
    middle = np.array(
        [
            np.median(np.nan_to_num(own[use], nan=np.inf)) if use.any() else np.nan
            for own, use in zip(error, there, strict=True)
        ]
    )
    error = error[there]
    error = np.minimum(np.nan_to_num(error, nan=np.inf), _FAR * np.nanmedian(error))
    inside = np.matmul(rig.rotation, points) + rig.translation[:, :, None]
    focal = np.array([camera.focal for camera in rig.cameras])
    perspective = np.array(
        [
            _beyond_affine(points[:, own].T, turned[:, own].T)
            for own, turned in zip(there, inside, strict=True)
        ]
    )
    return Fit(
        float(np.sqrt((error**2).mean())), middle / focal, noise * focal, perspective * focal
    )


def outlier_cameras(found: Fit) -> Bools:
    """`[view]` cameras whose errors are several times those of the others: out of step, moved, or with wrong intrinsics.

    Of two cameras both have the errors.
    """
    views = len(found.angle)
    others = [np.median(np.delete(found.angle, view)) for view in range(views)]
    return found.angle > _SEVERAL * np.array(others) if views > 2 else np.zeros(views, dtype=bool)


def fit_equally_well(first: Fit, second: Fit) -> bool:
    """Two rigs that fit as well: what was seen does not tell which one is right."""
    return max(first.misfit, second.misfit) <= _ALIKE * min(first.misfit, second.misfit)


def weak_perspective(found: Fit) -> Bools:
    """`[view]` cameras so far away, for the size of what they see, that perspective drowns in the noise."""
    return found.perspective < found.noise


def _beyond_affine(points: Floats, turned: Floats) -> float:
    """RMS distance of the images of points `[N, 3]` from those of the best affine camera, in radians."""
    image = turned[:, :2] / turned[:, 2:]
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    residual = image - homogeneous @ np.linalg.lstsq(homogeneous, image, rcond=None)[0]
    return float(np.sqrt((residual**2).sum(1).mean())) if len(points) else 0.0


def _halves(recording: Sample, seed: int) -> Iterator[Sample]:
    """The recording with one half of its joints and with the other, drawn at random, several times."""
    rng = np.random.default_rng(seed)
    for _ in range(_SPLITS):
        order = rng.permutation(len(recording.keypoints))
        for part in (order[::2], order[1::2]):
            yield _only(recording, np.isin(np.arange(len(order)), part))


def _only(recording: Sample, joints: Bools) -> Sample:
    return replace(
        recording,
        positions=np.where(joints[:, None], recording.positions, np.nan),
        confidence=np.where(joints, recording.confidence, 0.0),
        rays=np.where(joints[:, None], recording.rays, np.nan),
    )
