"""Where one camera stands, given bodies that other cameras place: several poses of it at once.

The camera's detections need not be matched to the bodies: a detection counts by the body of its
frame that fits it best under a pose, and no error counts for more than that of a stranger.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_calib.adjust.camera_fit import CameraPose
from mocap_calib.config import Config, MovedConfig
from mocap_calib.geometry.rotation import matrix_from_vector, nearest_rotation, skew
from mocap_calib.kernels.loading import contiguous
from mocap_calib.kernels.resection import compare
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.observed import PlacedCameras, choose_frames, place_bodies
from mocap_calib.types import POSE, Bools, Floats, Ints, Sample

_UNIT = 0.1  # radians: a tolerance that tells the nearest body from the others
_RIDGE = 1e-9  # of the diagonal of normal equations
_REFINED = 8  # poses that are refined, of those that single detections ask for


@dataclass(frozen=True)
class Sightings:
    """What one camera saw, and the bodies that were there.

    frame: `[detection]` indices of the frames, ascending.
    rays: `[detection, joint, 3]` unit vectors in the camera's frame, NaN = missing.
    bodies: `[frame, body, joint, 3]` in world coordinates, NaN = missing.
    """

    frame: Ints
    rays: Floats
    bodies: Floats

    @property
    def angular_size(self) -> Floats:
        """`[detection]` RMS angle in radians of the joints from their centroid."""
        middle = np.nanmean(self.rays, axis=1, keepdims=True)
        return np.sqrt(np.nanmean(((self.rays - middle) ** 2).sum(-1), axis=1))

    @cached_property
    def packed(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Rays and bodies as the kernel takes them, each with 1 where a joint is there, else 0.

        `[detection, 3, joint]`, `[detection, joint]`, `[frame, body, 3, joint]` and
        `[frame, body, joint]`.
        """
        rays, bodies = (np.swapaxes(each, -1, -2) for each in (self.rays, self.bodies))
        seen, known = (np.isfinite(each[..., 0, :]).astype(np.float64) for each in (rays, bodies))
        rays, seen = contiguous(np.nan_to_num(rays), seen)
        bodies, known = contiguous(np.nan_to_num(bodies), known)
        return rays, seen, bodies, known


@dataclass(frozen=True)
class CameraPoses:
    """Poses that a camera may have: cam_from_world.

    rotation: `[pose, 3, 3]`; translation: `[pose, 3]`.
    """

    rotation: Floats
    translation: Floats

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, index: Ints | slice) -> "CameraPoses":
        return CameraPoses(self.rotation[index], self.translation[index])

    def __add__(self, other: "CameraPoses") -> "CameraPoses":
        return CameraPoses(
            np.concatenate([self.rotation, other.rotation]),
            np.concatenate([self.translation, other.translation]),
        )


@dataclass(frozen=True)
class Linear:
    """Least squares of small changes of poses: three angles, three shares of the depth.

    normal: `[pose, detection, 6, 6]`, target: `[pose, detection, 6]`: A and b of A x = -b.
    square: `[pose, detection]` the weighed squared error. depth: `[pose]` of the bodies.
    """

    normal: Floats
    target: Floats
    square: Floats
    depth: Floats


@dataclass(frozen=True)
class _Compared:
    """How poses fit detections.

    cost: `[pose, detection]` in 0..1, NaN where no body can be compared.
    body: `[pose, detection]` index of the body that fits best.
    """

    cost: Floats
    body: Ints


def sightings_of(rays: Floats, bodies: Floats, least_joints: int) -> Sightings:
    """Return the detections that a body of their frame has enough joints in common with.

    rays: `[frame, instance, joint, 3]` of one camera; bodies: `[frame, body, joint, 3]`.
    """
    seen = np.isfinite(rays[..., 0]).astype(np.float64)
    known = np.isfinite(bodies[..., 0]).astype(np.float64)
    common = np.einsum("fkj,fij->fki", seen, known).max(-1, initial=0.0)
    frame, instance = np.nonzero(common >= least_joints)
    return Sightings(frame, rays[frame, instance], bodies)


def costs_of(
    poses: CameraPoses, seen: Sightings, tolerance: Floats | float, least_joints: int
) -> Floats:
    """Return the cost `[pose, detection]` in 0..1 of detections; NaN where nothing is comparable.

    It is the mean over joints of q / (1 + q), q = (angle / tolerance)^2 (Geman and McClure's).
    tolerance: radians, of all or of each detection `[detection]`.
    """
    return _compare(poses, seen, np.broadcast_to(tolerance, len(seen.frame)), least_joints).cost


def propose_poses(start: CameraPoses, seen: Sightings, config: MovedConfig) -> CameraPoses:
    """Return the poses that single detections ask for, if the camera turned where it stands.

    start: one pose, whose centre is kept. Each is the rotation that turns one body as seen from
    there into one detection of its frame (Kabsch); of several bodies each has its turn.
    """
    chosen = evenly_spaced(np.arange(len(seen.frame)), config.hypotheses)
    bodies, rays = seen.bodies[seen.frame[chosen]], seen.rays[chosen]
    common = np.isfinite(bodies[..., 0]) & np.isfinite(rays[:, None, :, 0])  # [N, body, joint]
    possible = common.sum(-1) >= config.least_joints
    every = np.arange(len(chosen))
    turn = every % np.maximum(possible.sum(1), 1)
    drawn = (possible & (possible.cumsum(1) == turn[:, None] + 1)).argmax(1)
    centre = -start.rotation[0].T @ start.translation[0]
    used = common[every, drawn][..., None]
    toward = np.where(used, bodies[every, drawn] - centre, 0.0)
    toward /= np.maximum(np.linalg.norm(toward, axis=-1, keepdims=True), 1e-12)
    rays = np.where(used, rays, 0.0)
    rotation = nearest_rotation(np.einsum("nji,njk->nik", rays, toward))
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

    counted: `[pose, detection]`. tolerances: radians, one for each step.
    """
    every = np.arange(len(seen.frame))
    for tolerance in tolerances:
        body = _compare(poses, seen, np.full(len(every), tolerance), least_joints).body
        points = seen.bodies[seen.frame, body]  # [pose, detection, joint, 3]
        poses = _step(poses, points, seen.rays, counted=counted, tolerance=tolerance)
    return poses


def linearise(poses: CameraPoses, seen: Sightings, tolerance: float, least_joints: int) -> Linear:
    """Return the least-squares problem of poses, of all detections by the bodies that fit best."""
    every = np.full(len(seen.frame), tolerance)
    points = seen.bodies[seen.frame, _compare(poses, seen, every, least_joints).body]
    counted = np.ones((len(poses), len(every)), dtype=bool)
    return _linearise(poses, points, seen.rays, counted=counted, tolerance=tolerance)


def typical_error(poses: CameraPoses, seen: Sightings, counted: Bools, least_joints: int) -> float:
    """Return the median angle in radians of joints from those of their bodies.

    Of each body in a frame the detection counts that is nearest to it: others are of strangers.
    counted: `[pose, detection]` the detections of each pose.
    """
    every = np.full(len(seen.frame), _UNIT)
    compared = _compare(poses, seen, every, least_joints)
    pose, detection = np.nonzero(counted & np.isfinite(compared.cost))
    body, cost = compared.body[pose, detection], compared.cost[pose, detection]
    order = np.lexsort([cost, body, seen.frame[detection]])
    pose, detection, body = pose[order], detection[order], body[order]
    same = (np.diff(seen.frame[detection]) == 0) & (np.diff(body) == 0)
    nearest = np.append(True, ~same)
    pose, detection, body = pose[nearest], detection[nearest], body[nearest]
    points = seen.bodies[seen.frame[detection], body]
    in_camera = np.einsum("nij,nkj->nki", poses.rotation[pose], points)
    in_camera += poses.translation[pose][:, None]
    unit = in_camera / np.linalg.norm(in_camera, axis=-1, keepdims=True)
    return float(np.nanmedian(np.linalg.norm(unit - seen.rays[detection], axis=-1)))


def _compare(
    poses: CameraPoses, seen: Sightings, tolerance: Floats, least_joints: int
) -> _Compared:
    """Return how poses fit the detections."""
    shape = len(poses), len(seen.frame)
    cost, body = np.empty(shape), np.empty(shape, dtype=np.int64)
    given = contiguous(poses.rotation, poses.translation, seen.frame)
    compare(*given, *seen.packed, *contiguous(tolerance), least_joints, cost, body)
    return _Compared(cost, body)


def _step(
    poses: CameraPoses, points: Floats, rays: Floats, *, counted: Bools, tolerance: float
) -> CameraPoses:
    """Return the poses after a Gauss-Newton step on unit vectors, reweighted by the loss.

    points: `[pose, detection, joint, 3]` in world coordinates, NaN = missing.
    """
    problem = _linearise(poses, points, rays, counted=counted, tolerance=tolerance)
    normal, target = problem.normal.sum(1), problem.target.sum(1)
    ridge = _RIDGE * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12
    change = -np.linalg.solve(normal + ridge * np.eye(POSE), target[..., None])[..., 0]
    turn = matrix_from_vector(change[:, :3])
    moved = np.einsum("pij,pj->pi", turn, poses.translation)
    return CameraPoses(turn @ poses.rotation, moved + problem.depth[:, None] * change[:, 3:])


def _linearise(
    poses: CameraPoses, points: Floats, rays: Floats, *, counted: Bools, tolerance: float
) -> Linear:
    """Return the least-squares problem of each detection about poses."""
    known = np.isfinite(points[..., 0]) & np.isfinite(rays[..., 0]) & counted[..., None]
    points, rays = np.where(known[..., None], points, 1.0), np.nan_to_num(rays)
    in_camera = np.matmul(points, np.swapaxes(poses.rotation, 1, 2)[:, None])
    in_camera += poses.translation[:, None, None]
    length = np.maximum(np.sqrt((in_camera**2).sum(-1)), 1e-12)
    unit = in_camera / length[..., None]
    gap = unit - rays
    square = (gap**2).sum(-1)
    weight = known / (1 + square / tolerance**2) ** 2
    across = (np.eye(3) - unit[..., :, None] * unit[..., None, :]) / length[..., None, None]
    # translations in units of the depth, so that both halves are of one size
    depth = np.maximum((weight * length).sum((1, 2)) / np.maximum(weight.sum((1, 2)), 1e-12), 1e-12)
    # across @ skew(in_camera) is skew(unit): what is along the ray does not turn it
    slope = np.concatenate([-skew(unit), across * depth[:, None, None, None, None]], axis=-1)
    number, detections = weight.shape[:2]
    slope = slope.reshape(number, detections, -1, POSE)
    weighed = np.swapaxes(np.repeat(weight, 3, axis=2)[..., None] * slope, 2, 3)
    return Linear(
        normal=weighed @ slope,
        target=(weighed @ gap.reshape(number, detections, -1, 1))[..., 0],
        square=(weight * square).sum(-1),
        depth=depth,
    )


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
