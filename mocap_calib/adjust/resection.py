"""Find the pose or the projection of one camera, given bodies that other cameras place.

The camera's detections need not be matched to the bodies: a detection counts by the body of its
frame that fits it best, and no error counts for more than that of a stranger.

Poses are proposed by single detections. Where the images may be anything, eleven numbers describe
how any pinhole camera sees the world, mirrored or not, of any focal length, principal point and
size of its images: x ~ P X (direct linear transformation; Hartley and Zisserman 2004, section 7.1),
searched for by hypotheses of a few frames (RANSAC, Fischler and Bolles 1981).
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.camera_fit import Seen, fit_camera
from mocap_calib.config import (
    LEAST_FORWARD,
    LEAST_JOINTS,
    Config,
    MovedConfig,
    ResectionConfig,
)
from mocap_calib.geometry.lens import decompose_projection
from mocap_calib.geometry.rotation import matrix_from_vector, nearest_rotation
from mocap_calib.kernels.association import compare_bodies
from mocap_calib.kernels.jit import contiguous
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.triangulate import PlacedCameras, choose_frames, place_bodies
from mocap_calib.types import Bools, Floats, Ints, Sample

FITS = 0.5  # cost below which a detection may show a body
_CLEARLY = 0.5  # of the other cost: one of two readings is clearly better


@dataclass(frozen=True)
class Sightings:
    """What one camera saw, and the bodies that were there.

    frame: `[detection]` indices of the frames, ascending; instance: of the detections in these.
    image: `[detection, joint, 2]` image points without distortion in focal lengths, NaN = missing.
    bodies: `[frame, body, joint, 3]` in world coordinates, NaN = missing.
    """

    frame: Ints
    instance: Ints
    image: Floats
    bodies: Floats

    @property
    def rays(self) -> Floats:
        """Unit vectors `[detection, joint, 3]` in the camera's frame, NaN = missing."""
        rays = np.concatenate([self.image, np.ones_like(self.image[..., :1])], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    @property
    def size(self) -> Floats:
        """`[detection]` RMS distance in focal lengths of the joints from their centroid."""
        middle = np.nanmean(self.image, axis=1, keepdims=True)
        return np.sqrt(np.nanmean(((self.image - middle) ** 2).sum(-1), axis=1))

    def select(self, index: Ints) -> "Sightings":
        """Return some of the detections (`[n]` indices)."""
        return Sightings(self.frame[index], self.instance[index], self.image[index], self.bodies)

    def joints_in_common(self) -> Bools:
        """Return `[detection, body, joint]` what is known of a detection and of a body."""
        known = np.isfinite(self.bodies[self.frame, ..., 0])
        return np.asarray(known & np.isfinite(self.image[:, None, :, 0]))

    def known_points(self, body: Ints, counted: Bools, image: Floats, *, blocks: int = 1) -> Seen:
        """Return the joints of bodies (`[detection]` indices) and where they were seen.

        counted: `[detection]` of which these are. image: `[detection, joint, 2]` where, in pixels
        or focal lengths. blocks: stretches of time.
        """
        points = self.bodies[self.frame, body]
        both = np.isfinite(points[..., 0]) & np.isfinite(image[..., 0])
        detection, joint = np.nonzero(both & counted[:, None])
        block = self.frame[detection] * blocks // len(self.bodies)
        return Seen(points[detection, joint], image[detection, joint], block, joint)


def sightings_of(rays: Floats, bodies: Floats) -> Sightings:
    """Return the detections that a body of their frame has enough joints in common with.

    rays: `[frame, instance, joint, 3]` of one camera; bodies: `[frame, body, joint, 3]`.
    """
    image = rays[..., :2] / np.where(rays[..., 2:] > LEAST_FORWARD, rays[..., 2:], np.nan)
    frame, instance = np.nonzero(np.isfinite(image[..., 0]).sum(-1) >= LEAST_JOINTS)
    every = Sightings(frame, instance, image[frame, instance], bodies)
    common = every.joints_in_common().sum(-1).max(-1, initial=0)
    return every.select(np.flatnonzero(common >= LEAST_JOINTS))


@dataclass(frozen=True)
class Compared:
    """How projections fit detections.

    cost: `[projection, detection]` in 0..1, NaN where no body can be compared.
    body: `[projection, detection]` index of the body that fits best.
    """

    cost: Floats
    body: Ints


def compare_projections(
    projections: Floats, seen: Sightings, tolerance: Floats | float
) -> Compared:
    """Return how projections, or poses, `[projection, 3, 4]` fit the detections.

    The cost is the mean over joints of q / (1 + q), q = (distance / tolerance)^2: 1 less the weight
    under Cauchy's loss. tolerance: in the image, of all or of each detection `[detection]`.
    """
    shape = len(projections), len(seen.frame)
    cost, body = np.empty(shape), np.empty(shape, dtype=np.int64)
    image, bodies = np.swapaxes(seen.image, -1, -2), np.swapaxes(seen.bodies, -1, -2)
    tolerance = np.broadcast_to(tolerance, len(seen.frame)).astype(np.float64)
    given = contiguous(projections, seen.frame, image, bodies, tolerance)
    compare_bodies(*given, LEAST_JOINTS, cost, body)
    return Compared(cost, body)


# --- poses


def propose_poses(start: Floats, seen: Sightings, config: MovedConfig) -> Floats:
    """Return a pose, and those that single detections ask for if the camera turned where it is.

    `[pose, 3, 4]` cam_from_world. start: `[3, 4]`, whose centre is kept. Each is the rotation that
    turns one body as seen from there into one detection of its frame (Kabsch); of several bodies
    each has its turn.
    """
    some = seen.select(evenly_spaced(np.arange(len(seen.frame)), 2 * config.stretches))
    common = some.joints_in_common()
    possible = common.sum(-1) >= LEAST_JOINTS
    every = np.arange(len(some.frame))
    turn = every % np.maximum(possible.sum(1), 1)
    drawn = (possible & (possible.cumsum(1) == turn[:, None] + 1)).argmax(1)
    centre = -start[:, :3].T @ start[:, 3]
    used = common[every, drawn][..., None]
    toward = np.where(used, some.bodies[some.frame, drawn] - centre, 0.0)
    toward /= np.maximum(np.linalg.norm(toward, axis=-1, keepdims=True), 1e-12)
    rotation = nearest_rotation(np.einsum("nji,njk->nik", np.where(used, some.rays, 0.0), toward))
    proposed = np.concatenate([rotation, -(rotation @ centre)[..., None]], axis=-1)
    return np.concatenate([start[None], proposed])


def refine_poses(
    poses: Floats, seen: Sightings, *, counted: Bools, tolerances: Floats
) -> tuple[Floats, float]:
    """Return poses `[pose, 3, 4]` of least robust cost, each of its own detections.

    By a step of Gauss and Newton at each tolerance, to the bodies that fit best before it. The
    second: the median distance in focal lengths of joints from those of their bodies, before the
    last step, of the detections that show a body at the first tolerance.
    counted: `[pose, detection]`. tolerances: focal lengths, one for each step.
    """
    pose, detection = np.nonzero(counted)
    image, axis = seen.image[detection], np.eye(3)
    shown = compare_projections(poses, seen, tolerances[0]).cost[pose, detection] < FITS
    for tolerance in tolerances:
        body = compare_projections(poses, seen, tolerance).body[pose, detection]
        points = seen.bodies[seen.frame[detection], body]
        turned = np.einsum("nij,nkj->nki", poses[pose, :, :3], points)
        in_camera = turned + poses[pose, None, :, 3]
        depth = np.where(in_camera[..., 2:] > 0, in_camera[..., 2:], np.nan)
        at = in_camera[..., :2] / depth
        error = at - image
        # how the image moves with the point, a turn of the camera's axes and a shift
        slope = (axis[:2] - at[..., None] * axis[2]) / depth[..., None]
        rows = np.concatenate([np.cross(turned[..., None, :], slope), slope], axis=-1)
        rows = np.concatenate([rows, error[..., None]], axis=-1)
        weight = 1 / (1 + (error**2).sum(-1) / tolerance**2)
        rows = np.nan_to_num(rows * np.sqrt(weight)[..., None, None]).reshape(len(pose), -1, 7)
        blocks = np.zeros((len(poses), 7, 7))
        np.add.at(blocks, pose, np.swapaxes(rows, 1, 2) @ rows)
        poses = _moved(poses, blocks)
    distance = np.linalg.norm(error[shown], axis=-1)
    distance = distance[np.isfinite(distance)]
    return poses, float(np.median(distance)) if len(distance) else np.inf


def _moved(poses: Floats, blocks: Floats) -> Floats:
    """Return poses after the steps that solve normal equations `[pose, 7, 7]`, error last."""
    normal, target = blocks[:, :6, :6], blocks[:, :6, 6:]
    scale = 1 / np.sqrt(np.maximum(np.einsum("pii->pi", normal), 1e-150))[..., None]
    scaled = scale * normal * np.swapaxes(scale, 1, 2) + 1e-9 * np.eye(6)
    step = -(scale * np.linalg.solve(scaled, scale * target))[..., 0]
    rotation = matrix_from_vector(step[:, :3]) @ poses[..., :3]
    return np.concatenate([rotation, (poses[..., 3] + step[:, 3:])[..., None]], axis=-1)


# --- any projection


@dataclass(frozen=True)
class Resection:
    """A projection, and the identities of the detections under it.

    projection: `[3, 4]` P, with P X in front of the camera where its third row is positive.
    individual: `[detection]` the body that each detection shows, -1 = unmatched.
    cost: 0..1, mean over the detections of their robust errors; 1 where nothing fits.
    tolerance: distance in the image at which a joint costs half.
    """

    projection: Floats
    individual: Ints
    cost: float
    tolerance: float


def resect(seen: Sightings, config: ResectionConfig, *, seed: int) -> Resection | None:
    """Return the projection that most of the detections agree with; None where there is none."""
    # linear systems of points and image points of unit size are well conditioned (Hartley 1997)
    to_points, to_image = _unit_size(seen.bodies), _unit_size(seen.image)
    scene = replace(seen, bodies=_apply(to_points, seen.bodies), image=_apply(to_image, seen.image))
    frames = np.unique(scene.frame)
    if len(frames) < config.frames:
        return None
    projections = _draw_projections(scene, config, seed=seed)
    scored = np.isin(scene.frame, evenly_spaced(frames, config.frames_scored))
    part = scene.select(np.flatnonzero(scored))
    rough = np.nanmean(compare_projections(projections, part, config.tolerance).cost, axis=1)
    chosen = np.argsort(rough, kind="stable")[: config.hypotheses_refined]
    found = [_refine(scene, projections[index], config) for index in chosen]
    best = min(found, key=lambda each: each.cost)
    return replace(
        best,
        projection=np.linalg.inv(to_image) @ best.projection @ to_points,
        tolerance=best.tolerance / to_image[0, 0],
    )


def match(seen: Sightings, projection: Floats, tolerance: float) -> tuple[Ints, float]:
    """Return the body `[detection]` of each detection, and the mean cost of a projection.

    tolerance: distance in the image at which a joint costs half.
    """
    found = compare_projections(projection[None], seen, tolerance)
    cost = np.nan_to_num(found.cost[0], nan=1.0)
    return np.where(cost < FITS, found.body[0], -1), float(cost.mean())


def exchanged_share(
    seen: Sightings, exchanged: Sightings, projection: Floats, tolerance: float
) -> float:
    """Return the share of the detections that fit with exchanged sides alone.

    exchanged: the same detections with their sides exchanged. Those that fit with neither, or about
    as well with both, are not counted.
    """
    given, other = (
        compare_projections(projection[None], each, tolerance).cost[0] for each in (seen, exchanged)
    )
    as_given = ((given < FITS) & (given < _CLEARLY * other)).sum()
    as_other = ((other < FITS) & (other < _CLEARLY * given)).sum()
    return float(as_other) / max(int(as_given + as_other), 1)


def find_lost_camera(
    sample: Sample, placed: PlacedCameras, view: int, config: Config
) -> Floats | None:
    """Return the pose `[3, 4]` of a camera that matches no body, None where nothing shows it.

    placed: cameras that place bodies; the labels of the view (index) do not count.
    """
    diagnosis, camera = config.diagnosis, sample.cameras[view]
    frames = choose_frames(sample, config.moved.detections, config)
    bodies = place_bodies(sample, placed, frames, config, without=view)
    seen = sightings_of(sample.rays[view][frames], bodies)
    if len(seen.frame) < config.moved.least_detections:
        return None
    found = resect(seen, diagnosis.resection, seed=0)
    if found is None or (found.individual >= 0).mean() < diagnosis.least_matched:
        return None
    pixels = sample.positions[view][frames[seen.frame], seen.instance]
    known = seen.known_points(found.individual, found.individual >= 0, pixels)
    start = np.column_stack(decompose_projection(found.projection)[1:])
    noise = diagnosis.focal_noise * camera.focal
    return fit_camera(camera, known, start, diagnosis.fit, noise=noise).pose


def _unit_size(values: Floats) -> Floats:
    """Return the similarity `[C + 1, C + 1]` to a unit size about the median of `[..., C]`."""
    flat = values.reshape(-1, values.shape[-1])
    flat = flat[np.isfinite(flat).all(-1)]
    similarity = np.eye(values.shape[-1] + 1)
    if len(flat):
        middle = np.median(flat, axis=0)
        similarity[:-1] /= max(float(np.median(np.linalg.norm(flat - middle, axis=-1))), 1e-12)
        similarity[:-1, -1] = -similarity[0, 0] * middle
    return similarity


def _apply(similarity: Floats, values: Floats) -> Floats:
    """Return vectors `[..., C]` after a similarity."""
    return values * similarity[0, 0] + similarity[:-1, -1]


def _draw_projections(scene: Sightings, config: ResectionConfig, *, seed: int) -> Floats:
    """Return projections `[hypothesis, 3, 4]`, each of a few matches that may be right."""
    rng = np.random.default_rng(seed)
    _, first, count = np.unique(scene.frame, return_index=True, return_counts=True)
    picks = rng.random((config.hypotheses, len(first))).argsort(1)[:, : config.frames]
    shape = picks.shape
    detection = first[picks] + (rng.random(shape) * count[picks]).astype(np.int64)
    possible = scene.joints_in_common().sum(-1) >= LEAST_JOINTS
    chance = rng.random((*shape, possible.shape[1])) * possible[detection]
    points = scene.bodies[scene.frame[detection], chance.argmax(-1)]
    points = points.reshape(config.hypotheses, -1, 3)
    image = scene.image[detection].reshape(config.hypotheses, -1, 2)
    return _solve(points, image, np.ones(points.shape[:-1]))


def _solve(points: Floats, image: Floats, weight: Floats) -> Floats:
    """Return the projections `[..., 3, 4]` with x ~ P X, most points in front.

    points: `[..., N, 3]`; image: `[..., N, 2]`; NaN = missing. weight: `[..., N]`.
    """
    both = np.isfinite(points[..., 0]) & np.isfinite(image[..., 0])
    root = np.sqrt(np.where(both, weight, 0.0))[..., None]
    point = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    point, image = (np.where(both[..., None], each, 0.0) for each in (point, image))
    none = np.zeros_like(point)
    across = root * np.concatenate([point, none, -image[..., :1] * point], axis=-1)
    down = root * np.concatenate([none, point, -image[..., 1:] * point], axis=-1)
    system = np.swapaxes(across, -1, -2) @ across + np.swapaxes(down, -1, -2) @ down
    projection = np.linalg.eigh(system)[1][..., 0].reshape(*system.shape[:-2], 3, 4)
    depth = (point @ projection[..., 2, :, None])[..., 0]
    sign = np.where(np.sign(depth).sum(-1) < 0, -1.0, 1.0)
    return np.asarray(sign[..., None, None] * projection)


def _refine(scene: Sightings, projection: Floats, config: ResectionConfig) -> Resection:
    """Return the projection after rounds of matching and solving for what fits.

    The errors are algebraic, which is enough for a start: weights undo their scale with depth.
    """
    for _ in range(config.rounds):
        individual, _ = match(scene, projection, config.tolerance)
        if (individual < 0).all():
            break
        known = scene.known_points(individual, individual >= 0, scene.image)
        seen = known.points @ projection[:, :3].T + projection[:, 3]
        depth = np.where(seen[:, 2] > 1e-9, seen[:, 2], np.nan)
        error = seen[:, :2] / depth[:, None] - known.pixels
        square = (error**2).sum(-1) / config.tolerance**2
        weight = np.nan_to_num(1 / (1 + square) / depth**2)
        projection = _solve(known.points, known.pixels, weight)
    return Resection(projection, *match(scene, projection, config.tolerance), config.tolerance)
