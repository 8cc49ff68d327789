"""Find the projection of one camera from points that other cameras know, whatever its images are.

Eleven numbers say how any pinhole camera sees the world, mirrored or not, of any focal length,
principal point and size of its images: x ~ P X (direct linear transformation; Hartley and
Zisserman 2004, section 7.1). So one search answers for all that may be wrong with a camera's
images. Who is who is not known either: hypotheses come from a few frames with any assignment of
detections to bodies, and the one that most frames agree on wins (RANSAC, Fischler and Bolles 1981).
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import ResectionConfig
from mocap_calib.kernels.loading import contiguous
from mocap_calib.kernels.resection import cost_detections
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, Floats, Ints

_FITS = 0.5  # cost below which a detection may show a body
_CLEARLY = 0.5  # of the other cost: one of two readings is clearly better
_LEAST_COMPARED = 3  # joints of a detection and a body that are compared: six of two give eleven


@dataclass(frozen=True)
class Sighting:
    """Bodies that other cameras know, and what one camera saw in the same frames.

    points: `[frame, individual, keypoint, 3]` in world coordinates, NaN = not known.
    image: `[frame, instance, keypoint, 2]` image points without distortion, NaN = missing.
    """

    points: Floats
    image: Floats


@dataclass(frozen=True)
class Resection:
    """A projection, and who is who under it.

    projection: `[3, 4]` P, with P X in front of the camera where its third row is positive.
    individual: `[frame, instance]` whom each detection shows, -1 = nobody.
    cost: 0..1, mean over the detections of their robust errors; 1 where nothing fits.
    tolerance: distance in the image at which a joint costs half.
    """

    projection: Floats
    individual: Ints
    cost: float
    tolerance: float


@dataclass(frozen=True)
class Decomposition:
    """P = K [R t] with a positive second and third diagonal element of K.

    matrix: `[3, 3]` K, whose first element is negative where the image is mirrored.
    rotation: `[3, 3]` and translation: `[3]` of cam_from_world.
    """

    matrix: Floats
    rotation: Floats
    translation: Floats


def resect(sighting: Sighting, config: ResectionConfig, *, seed: int) -> Resection | None:
    """Return the projection that most of the detections agree with; None where there is none."""
    similar = _Normalisation.of(sighting)
    scene = Sighting(similar.points(sighting.points), similar.image(sighting.image))
    possible = _possible_matches(scene)
    if not possible.any():
        return None
    projections = _draw_projections(scene, possible, config, seed=seed)
    if not len(projections):
        return None
    scored = evenly_spaced(np.flatnonzero(possible.any((1, 2))), config.frames_scored)
    seen = Sighting(scene.points[scored], scene.image[scored])
    rough = np.array([match(seen, each, config.tolerance)[1] for each in projections])
    best: Resection | None = None
    for index in np.argsort(rough, kind="stable")[: config.hypotheses_refined]:
        found = _refine(scene, projections[index], config)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return Resection(
        similar.undo(best.projection),
        best.individual,
        best.cost,
        best.tolerance * similar.image_size,
    )


def match(scene: Sighting, projection: Floats, tolerance: float) -> tuple[Ints, float]:
    """Return whom each detection shows, `[frame, instance]`, and the cost of a projection.

    tolerance: distance in the image at which a joint costs half.
    """
    cost = _detection_costs(scene, projection, tolerance)
    least = cost.min(-1)
    detected: Bools = np.asarray(np.isfinite(scene.image[..., 0]).any(-1))
    detected &= np.asarray(np.isfinite(scene.points[..., 0]).any((1, 2)))[:, None]
    mean = float(least[detected].mean()) if detected.any() else 1.0
    return np.where(detected & (least < _FITS), cost.argmin(-1), -1), mean


def exchanged_share(given: Sighting, exchanged: Sighting, resection: Resection) -> float:
    """Return the share of the detections that fit with exchanged sides alone.

    given, exchanged: the same detections with the sides as given and exchanged. Those that fit
    with neither, or about as well with both, are not counted.
    """
    costs = [
        _detection_costs(each, resection.projection, resection.tolerance).min(-1)
        for each in (given, exchanged)
    ]
    fits = [
        np.asarray((cost < _FITS) & (cost < _CLEARLY * other))
        for cost, other in zip(costs, reversed(costs), strict=True)
    ]
    return float(fits[1].sum()) / max(int(fits[0].sum() + fits[1].sum()), 1)


def decompose(projection: Floats) -> Decomposition:
    """Return the intrinsics and the extrinsics of a projection `[3, 4]`.

    By RQ decomposition. The sign of P is taken as it is: what is in front of the camera has a
    positive third coordinate.
    """
    left = projection[:, :3]
    # RQ of M from QR of its rows and columns reversed
    q, r = np.linalg.qr(left[::-1].T)
    matrix = r.T[::-1, ::-1]
    rotation = q.T[::-1]
    sign = np.sign(np.diag(matrix))
    matrix, rotation = matrix * sign, sign[:, None] * rotation
    if np.linalg.det(rotation) < 0:
        flip = np.array([-1.0, 1.0, 1.0])
        matrix, rotation = matrix * flip, flip[:, None] * rotation
    translation = np.linalg.solve(matrix, projection[:, 3])
    scale = matrix[2, 2]
    return Decomposition(matrix / scale, rotation, translation)


@dataclass(frozen=True)
class _Normalisation:
    """Similarities that bring points and image points to a unit size about their middle.

    Linear systems of these are well conditioned (Hartley 1997).
    """

    middle: Floats
    size: float
    image_middle: Floats
    image_size: float

    @classmethod
    def of(cls, sighting: Sighting) -> "_Normalisation":
        """Return the similarities that normalise what was seen."""
        middle, size = _middle_and_size(sighting.points)
        image_middle, image_size = _middle_and_size(sighting.image)
        return cls(middle, size, image_middle, image_size)

    def points(self, points: Floats) -> Floats:
        """Return normalised points `[..., 3]`."""
        return (points - self.middle) / self.size

    def image(self, image: Floats) -> Floats:
        """Return normalised image points `[..., 2]`."""
        return (image - self.image_middle) / self.image_size

    def undo(self, projection: Floats) -> Floats:
        """Return a projection `[3, 4]` of normalised points as one of the points themselves."""
        from_image = np.diag([self.image_size, self.image_size, 1.0])
        from_image[:2, 2] = self.image_middle
        to_points = np.eye(4) / self.size
        to_points[:3, 3] = -self.middle / self.size
        to_points[3, 3] = 1.0
        return from_image @ projection @ to_points


def _middle_and_size(values: Floats) -> tuple[Floats, float]:
    """Return the median `[C]` of vectors `[..., C]` and their robust distance from it."""
    flat = values.reshape(-1, values.shape[-1])
    flat = flat[np.isfinite(flat).all(-1)]
    if not len(flat):
        return np.zeros(values.shape[-1]), 1.0
    middle = np.median(flat, axis=0)
    size = float(np.median(np.linalg.norm(flat - middle, axis=-1)))
    return middle, max(size, 1e-12)


def _possible_matches(scene: Sighting) -> Bools:
    """Return `[frame, instance, individual]` where enough joints are known of both."""
    seen = np.isfinite(scene.image[..., 0]).astype(np.int64)
    known = np.isfinite(scene.points[..., 0]).astype(np.int64)
    return np.einsum("fdk,fik->fdi", seen, known) >= _LEAST_COMPARED


def _draw_projections(
    scene: Sighting, possible: Bools, config: ResectionConfig, *, seed: int
) -> Floats:
    """Return projections `[hypothesis, 3, 4]`, each of a few matches that may be right."""
    rng = np.random.default_rng(seed)
    frames = np.flatnonzero(possible.any((1, 2)))
    if len(frames) < config.frames:
        return np.zeros((0, 3, 4))
    picks = rng.random((config.hypotheses, len(frames))).argsort(1)[:, : config.frames]
    frame = frames[picks]  # [hypothesis, few]
    chance = rng.random((*frame.shape, *possible.shape[1:])) * possible[frame]
    flat = chance.reshape(*frame.shape, -1).argmax(-1)
    instance, individual = np.unravel_index(flat, possible.shape[1:])
    system = _normal_equations(
        scene.points[frame, individual].reshape(config.hypotheses, -1, 3),
        scene.image[frame, instance].reshape(config.hypotheses, -1, 2),
        weight=None,
    )
    return _solve(system, scene.points[frame, individual].reshape(config.hypotheses, -1, 3))


def _normal_equations(points: Floats, image: Floats, weight: Floats | None) -> Floats:
    """Return A'A `[..., 12, 12]` of the equations x cross P X = 0 of points that are seen.

    points: `[..., N, 3]`; image: `[..., N, 2]`; NaN = missing. weight: `[..., N]`; None: all alike.
    """
    both = np.isfinite(points[..., 0]) & np.isfinite(image[..., 0])
    weight = both.astype(np.float64) if weight is None else np.where(both, weight, 0.0)
    x, y = np.moveaxis(np.where(both[..., None], image, 0.0), -1, 0)
    homogeneous = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    homogeneous = np.where(both[..., None], homogeneous, 0.0)
    by_power = np.stack([weight, weight * x, weight * y, weight * (x * x + y * y)], axis=-2)
    weighted = by_power[..., None] * homogeneous[..., None, :, :]  # [..., power, N, 4]
    one, by_x, by_y, square = np.moveaxis(
        np.swapaxes(weighted, -1, -2) @ homogeneous[..., None, :, :], -3, 0
    )
    none = np.zeros_like(one)
    rows = [
        np.concatenate([one, none, -by_x], axis=-1),
        np.concatenate([none, one, -by_y], axis=-1),
        np.concatenate([-by_x, -by_y, square], axis=-1),
    ]
    return np.concatenate(rows, axis=-2)


def _solve(system: Floats, points: Floats) -> Floats:
    """Return the projections `[..., 3, 4]` of normal equations, with most points in front.

    points: `[..., N, 3]`, NaN = missing.
    """
    projection = np.linalg.eigh(system)[1][..., 0].reshape(*system.shape[:-2], 3, 4)
    depth = points @ projection[..., 2, :3, None] + projection[..., 2, 3, None, None]
    sign = np.where(np.nansum(np.sign(depth), axis=(-1, -2)) < 0, -1.0, 1.0)
    return sign[..., None, None] * projection


def _detection_costs(scene: Sighting, projection: Floats, tolerance: float) -> Floats:
    """Return `[frame, instance, individual]` mean costs in 0..1, 1 where nothing compares."""
    cost = np.empty((*scene.image.shape[:2], scene.points.shape[1]))
    arrays = contiguous(scene.points, scene.image, projection)
    cost_detections(*arrays, tolerance**2, _LEAST_COMPARED, cost)
    return cost


def _refine(scene: Sighting, projection: Floats, config: ResectionConfig) -> Resection:
    """Return the projection after rounds of matching and solving for what fits.

    The errors are algebraic, which is enough for a start: weights undo their scale with depth.
    """
    tolerance = config.tolerance
    for _ in range(config.rounds):
        individual, _ = match(scene, projection, tolerance)
        frame, instance = np.nonzero(individual >= 0)
        if not len(frame):
            break
        points = scene.points[frame, individual[frame, instance]].reshape(-1, 3)
        image = scene.image[frame, instance].reshape(-1, 2)
        seen = points @ projection[:, :3].T + projection[:, 3]
        depth = np.where(seen[:, 2] > 1e-9, seen[:, 2], np.nan)
        square = ((seen[:, :2] / depth[:, None] - image) ** 2).sum(-1) / tolerance**2
        weight = np.nan_to_num(1 / (1 + square) ** 2 / depth**2)
        projection = _solve(_normal_equations(points, image, weight), points)
    individual, cost = match(scene, projection, tolerance)
    return Resection(projection, individual, cost, tolerance)
