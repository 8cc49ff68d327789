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

from mocap_calib.adjust.camera_fit import (
    CameraPose,
    CameraPoses,
    Seen,
    Unknowns,
    cauchy_loss,
    fit_camera,
    linearise_camera,
)
from mocap_calib.config import LEAST_FORWARD, CameraFitConfig, Config, MovedConfig, ResectionConfig
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.kernels.jit import contiguous
from mocap_calib.kernels.resection import compare
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.observed import PlacedCameras, choose_frames, place_bodies
from mocap_calib.types import POSE, Bools, Camera, Floats, Ints, Sample

_UNIT = 0.1  # focal lengths: a tolerance that tells the nearest body from the others
_REFINED = 8  # poses that are refined, of those that single detections ask for
_FITS = 0.5  # cost below which a detection may show a body
_CLEARLY = 0.5  # of the other cost: one of two readings is clearly better
_LEAST_COMPARED = 3  # joints of a detection and a body that are compared: six of two give eleven
_PINHOLE = Camera("", (0, 0), np.eye(3))  # whose pixels are focal lengths
_ROUND = CameraFitConfig(loss_scales=(1.0,), steps=5)  # of one tolerance


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

    def known_points(self, body: Ints, counted: Bools) -> Seen:
        """Return the joints of bodies (`[detection]` indices) and where they were seen.

        counted: `[detection]` of which these are.
        """
        points = self.bodies[self.frame, body]
        both = np.isfinite(points[..., 0]) & np.isfinite(self.image[..., 0])
        detection, joint = np.nonzero(both & counted[:, None])
        return Seen(points[detection, joint], self.image[detection, joint], detection, joint)


def sightings_of(rays: Floats, bodies: Floats, least_joints: int = _LEAST_COMPARED) -> Sightings:
    """Return the detections that a body of their frame has enough joints in common with.

    rays: `[frame, instance, joint, 3]` of one camera; bodies: `[frame, body, joint, 3]`.
    """
    image = rays[..., :2] / np.where(rays[..., 2:] > LEAST_FORWARD, rays[..., 2:], np.nan)
    frame, instance = np.nonzero(np.isfinite(image[..., 0]).sum(-1) >= least_joints)
    every = Sightings(frame, instance, image[frame, instance], bodies)
    common = every.joints_in_common().sum(-1).max(-1, initial=0)
    return every.select(np.flatnonzero(common >= least_joints))


@dataclass(frozen=True)
class Compared:
    """How projections fit detections.

    cost: `[projection, detection]` in 0..1, NaN where no body can be compared.
    body: `[projection, detection]` index of the body that fits best.
    """

    cost: Floats
    body: Ints


def compare_projections(
    projections: Floats, seen: Sightings, tolerance: Floats | float, least_joints: int
) -> Compared:
    """Return how projections `[projection, 3, 4]` fit the detections.

    The cost is the mean over joints of q / (1 + q), q = (distance / tolerance)^2: 1 less the weight
    under Cauchy's loss. tolerance: in the image, of all or of each detection `[detection]`.
    """
    shape = len(projections), len(seen.frame)
    cost, body = np.empty(shape), np.empty(shape, dtype=np.int64)
    image, bodies = np.swapaxes(seen.image, -1, -2), np.swapaxes(seen.bodies, -1, -2)
    tolerance = np.broadcast_to(tolerance, len(seen.frame)).astype(np.float64)
    given = contiguous(projections, seen.frame, image, bodies, tolerance)
    compare(*given, least_joints, cost, body)
    return Compared(cost, body)


# --- poses


def compare_poses(
    poses: CameraPoses, seen: Sightings, tolerance: Floats | float, least_joints: int
) -> Compared:
    """Return how poses fit the detections; see `compare_projections`."""
    projections = np.concatenate([poses.rotation, poses.translation[..., None]], axis=-1)
    return compare_projections(projections, seen, tolerance, least_joints)


def costs_of(
    poses: CameraPoses, seen: Sightings, tolerance: Floats | float, least_joints: int
) -> Floats:
    """Return the cost `[pose, detection]` in 0..1 of detections; NaN where nothing is comparable.

    See `compare_projections`.
    """
    return compare_poses(poses, seen, tolerance, least_joints).cost


def propose_poses(start: CameraPoses, seen: Sightings, config: MovedConfig) -> CameraPoses:
    """Return the poses that single detections ask for, if the camera turned where it stands.

    start: one pose, whose centre is kept. Each is the rotation that turns one body as seen from
    there into one detection of its frame (Kabsch); of several bodies each has its turn.
    """
    some = seen.select(evenly_spaced(np.arange(len(seen.frame)), config.hypotheses))
    common = some.joints_in_common()
    possible = common.sum(-1) >= config.least_joints
    every = np.arange(len(some.frame))
    turn = every % np.maximum(possible.sum(1), 1)
    drawn = (possible & (possible.cumsum(1) == turn[:, None] + 1)).argmax(1)
    centre = -start.rotation[0].T @ start.translation[0]
    used = common[every, drawn][..., None]
    toward = np.where(used, some.bodies[some.frame, drawn] - centre, 0.0)
    toward /= np.maximum(np.linalg.norm(toward, axis=-1, keepdims=True), 1e-12)
    rotation = nearest_rotation(np.einsum("nji,njk->nik", np.where(used, some.rays, 0.0), toward))
    return CameraPoses(rotation, -rotation @ centre)


def refine_poses(
    poses: CameraPoses,
    seen: Sightings,
    *,
    counted: Bools,
    tolerances: tuple[float, ...],
    least_joints: int,
) -> CameraPoses:
    """Return poses of least robust cost, each of its own detections; matched again at each step.

    counted: `[pose, detection]`. tolerances: focal lengths, one for each step.
    """
    for tolerance in tolerances:
        bodies = compare_poses(poses, seen, tolerance, least_joints).body
        moved = [
            fit_camera(_PINHOLE, seen.known_points(body, own), pose, _ROUND, noise=tolerance).pose
            for pose, body, own in zip(poses.each(), bodies, counted, strict=True)
        ]
        poses = CameraPoses(
            np.stack([pose.rotation for pose in moved]),
            np.stack([pose.translation for pose in moved]),
        )
    return poses


@dataclass(frozen=True)
class PoseEquations:
    """Least squares of a small change of a pose, of each detection: A x = -b.

    normal: `[detection, 6, 6]` A; target: `[detection, 6]` b. square: `[detection]` the weighted
    squared error.
    """

    normal: Floats
    target: Floats
    square: Floats


def linearise(
    pose: CameraPose, seen: Sightings, tolerance: float, least_joints: int
) -> PoseEquations:
    """Return the least-squares problem of a pose, of all detections by the bodies that fit best."""
    one = CameraPoses(pose.rotation[None], pose.translation[None])
    body = compare_poses(one, seen, tolerance, least_joints).body[0]
    known = seen.known_points(body, np.ones(len(body), dtype=bool))
    found = linearise_camera(_PINHOLE, known, Unknowns(pose, np.zeros(0)), ())
    _, weight = cauchy_loss(found.residual, tolerance)
    rows = np.concatenate([found.jacobian, found.residual[None]])
    total = np.zeros((len(body), POSE + 1, POSE + 1))
    np.add.at(total, known.block, np.einsum("pcn,qcn,n->npq", rows, rows, weight))
    # in units that make both halves of the unknowns of one size
    unit = 1 / np.sqrt(np.maximum(np.diag(total.sum(0)), 1e-300))
    unit[POSE] = 1.0
    total *= unit[:, None] * unit
    return PoseEquations(total[:, :POSE, :POSE], total[:, :POSE, POSE], total[:, POSE, POSE])


def typical_error(poses: CameraPoses, seen: Sightings, counted: Bools, least_joints: int) -> float:
    """Return the median distance in focal lengths of joints from those of their bodies.

    Of each body in a frame the detection counts that is nearest to it: others are of strangers.
    counted: `[pose, detection]` the detections of each pose.
    """
    compared = compare_poses(poses, seen, _UNIT, least_joints)
    pose, detection = np.nonzero(counted & np.isfinite(compared.cost))
    body, cost = compared.body[pose, detection], compared.cost[pose, detection]
    order = np.argsort(cost, kind="stable")
    same = np.stack([seen.frame[detection], body])[:, order]
    nearest = order[np.unique(same, axis=1, return_index=True)[1]]
    pose, detection, body = pose[nearest], detection[nearest], body[nearest]
    points = seen.bodies[seen.frame[detection], body]
    in_camera = np.einsum("nij,nkj->nki", poses.rotation[pose], points)
    in_camera += poses.translation[pose][:, None]
    image = in_camera[..., :2] / in_camera[..., 2:]
    return float(np.nanmedian(np.linalg.norm(image - seen.image[detection], axis=-1)))


def find_lost_camera(
    sample: Sample, placed: PlacedCameras, view: int, config: Config
) -> CameraPose | None:
    """Return the pose of a camera whose detections match no body, None where nothing shows it.

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
    widest = settings.loose * float(np.median(seen.size))
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
    return poses.each()[best]


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
    rough = np.nanmean(
        compare_projections(projections, part, config.tolerance, _LEAST_COMPARED).cost, axis=1
    )
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
    found = compare_projections(projection[None], seen, tolerance, _LEAST_COMPARED)
    cost = np.nan_to_num(found.cost[0], nan=1.0)
    return np.where(cost < _FITS, found.body[0], -1), float(cost.mean())


def exchanged_share(seen: Sightings, exchanged: Sightings, resection: Resection) -> float:
    """Return the share of the detections that fit with exchanged sides alone.

    exchanged: the same detections with their sides exchanged. Those that fit with neither, or about
    as well with both, are not counted.
    """
    given, other = (
        compare_projections(
            resection.projection[None], each, resection.tolerance, _LEAST_COMPARED
        ).cost[0]
        for each in (seen, exchanged)
    )
    as_given = ((given < _FITS) & (given < _CLEARLY * other)).sum()
    as_other = ((other < _FITS) & (other < _CLEARLY * given)).sum()
    return float(as_other) / max(int(as_given + as_other), 1)


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
    possible = scene.joints_in_common().sum(-1) >= _LEAST_COMPARED
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
        known = scene.known_points(individual, individual >= 0)
        seen = known.points @ projection[:, :3].T + projection[:, 3]
        depth = np.where(seen[:, 2] > 1e-9, seen[:, 2], np.nan)
        error = seen[:, :2] / depth[:, None] - known.pixels
        square = (error**2).sum(-1) / config.tolerance**2
        weight = np.nan_to_num(1 / (1 + square) / depth**2)
        projection = _solve(known.points, known.pixels, weight)
    return Resection(projection, *match(scene, projection, config.tolerance), config.tolerance)
