"""Leave-one-out rigs: which cameras to leave out, and the points that the others place.

A camera that is wrong spoils the rig of all. Cheap signs, none of which is proof, say which cameras
deserve a rig without them.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.camera_fit import Unknown, fit_camera, pose_of
from mocap_calib.adjust.covariance import rig_covariance
from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.adjust.resection import Sightings, exchanged_share, match, sightings_of
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.errors import DegenerateError
from mocap_calib.faults.hypotheses import log_bayes_factor
from mocap_calib.geometry.rotation import nearest_rotation, quarter_turn
from mocap_calib.recording.corrections import exchanged_sides
from mocap_calib.results import CalibrationResult, GroupResult
from mocap_calib.rig import Observed, gather_tracks, leave_out_underconstrained
from mocap_calib.rig.associate import associate
from mocap_calib.rig.averaging import average
from mocap_calib.rig.triangulate import PlacedCameras, choose_frames, place_bodies
from mocap_calib.rig.view_graph import camera_groups, takes_all_pairs
from mocap_calib.types import Camera, CameraRig, Floats, Sample, silent
from mocap_calib.verdict.checks import errors, look_at

_FREE: tuple[Unknown, ...] = ("log_focal", "x", "y")
_LOW_SCORE = 0.8  # of a camera's pairs, as a share of that of the other pairs
_DETECTIONS = 120  # of one camera, that are held against the others


# --- which cameras


@dataclass(frozen=True)
class Held:
    """A view of a group held against the points that the others place in the rig of all.

    pose: `[3, 4]` in the rig. seen: its detections; pixels: `[detection, joint, 2]` of these.
    noise: focal lengths, of the view.
    """

    camera: Camera
    pose: Floats
    seen: Sightings
    pixels: Floats
    noise: float


def hold_each(observed: Observed, group: GroupResult, config: Config) -> list[Held]:
    """Return each view of a group, none of two: neither can be named, as both have the errors."""
    if len(group.rig) <= 2:
        return []
    observed, placed = PlacedCameras.of_group(observed, group, config)
    frames = choose_frames(observed.sample, _DETECTIONS, config)
    tracks = gather_tracks(observed.sample, placed.matches, frames)

    def hold(view: int) -> Held:
        """Return one view."""
        bodies = place_bodies(observed.sample, placed, frames, config, seen=tracks, without=view)
        seen = sightings_of(observed.sample.rays[view][frames], bodies)
        return Held(
            camera=group.rig.cameras[view],
            pose=pose_of(group.rig, view),
            seen=seen,
            pixels=observed.sample.positions[view][frames[seen.frame], seen.instance],
            noise=float(placed.noise[view]),
        )

    return list(map_in_threads(hold, range(len(group.rig))))


def screen_cameras(
    observed: Observed, result: CalibrationResult, held: list[Held], config: Config
) -> list[int]:
    """Return the views that deserve a closer look, those with the worst pairs first.

    A camera does that is not in the largest group, whose pairs have low scores, whose sides are
    exchanged often, whose image is rotated beside the others', or that asks for other intrinsics.
    Where half of the cameras are outside the largest group, either half may be wrong.
    Of two cameras neither can be named. held: the views of the largest group.
    """
    names, group = observed.recording.names, result.groups[0]
    members = np.array([names.index(name) for name in group.rig.names])
    odd = np.ones(len(names), dtype=bool)
    odd[members] = 2 * len(members) <= len(names)
    scores = _pair_scores(observed)
    odd |= scores < _LOW_SCORE
    if len(members) >= 3:
        turned = group.rig.rotation
        odd[members] |= [
            quarter_turn(own, np.delete(turned, view, axis=0), config.diagnosis.upright_deg) != 0
            for view, own in enumerate(turned)
        ]
        keypoints = observed.sample.keypoints
        odd[members] |= [differs(each, keypoints, config) for each in held]
    order = np.argsort(scores, kind="stable")
    return [int(view) for view in order if odd[view]]


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


def differs(held: Held, keypoints: tuple[str, ...], settings: Config) -> bool:
    """Return whether a camera asks for other intrinsics, or for exchanged sides.

    One asks for neither whose detections are of frames without points of the others.
    """
    config, seen, tolerance = settings.diagnosis, held.seen, settings.adjust.outlier * held.noise
    if not len(seen.frame):
        return False
    exchanged = replace(seen, image=seen.image[:, exchanged_sides(keypoints)])
    share = exchanged_share(seen, exchanged, held.pose, tolerance)
    body, _ = match(seen, held.pose, tolerance)
    known = seen.known_points(body, body >= 0, held.pixels, blocks=settings.uncertainty.time_blocks)
    if len(known.points) < config.least_keypoints:
        return False
    camera, rough = held.camera, config.focal_noise * held.camera.focal
    fit = fit_camera(camera, known, held.pose, config.fit, noise=rough, free=_FREE)
    size = np.array(camera.size) if all(camera.size) else np.full(2, 2 * camera.focal)
    sound = np.array([config.sound_focal, *(config.sound_centre * size)])
    faulty = np.array([config.faulty_focal, *(config.faulty_centre * size)])
    by_intrinsics = log_bayes_factor(fit.unknowns, fit.covariance, sound, faulty) > 0
    return by_intrinsics or share > config.exchanged_share / 2


def worst_camera(group: GroupResult, config: Config) -> int | None:
    """Return the view whose errors are several times those of the others, None = there is none."""
    error = errors(look_at(group, config))
    worst = int(np.argmax(np.nan_to_num(error)))
    usual = np.nanmedian(np.delete(error, worst)) if np.isfinite(error).sum() > 1 else np.nan
    return worst if error[worst] > config.uncertainty.outlier_factor * usual else None


# --- the rig without a camera


@dataclass(frozen=True)
class OtherCameras:
    """The leave-one-out rig of a camera.

    sample, placed: of the other cameras. pair_score: mean over the pairs of the rig.
    """

    sample: Sample
    placed: PlacedCameras
    pair_score: float

    @property
    def rig(self) -> CameraRig:
        """Of these cameras."""
        return self.placed.rig


def leave_out(
    observed: Observed, view: int, config: Config, *, most_deg: float = VERDICT_LIMITS_DEG[-1]
) -> OtherCameras | None:
    """Return the leave-one-out rig of a view (index); None where the others determine no rig.

    In a large rig the others are those that were paired with the view. most_deg: standard deviation
    of the least certain camera.
    """
    others = _others(observed, view, config)
    rough = replace(config, adjust=replace(config.adjust, rounds=1, points=4000))

    def build(some: Observed) -> OtherCameras:
        """Return the rig of some cameras."""
        return _build(some, rough)

    try:
        group = camera_groups(others.recording.cameras, others.pairs, config.averaging)[0]
        found = leave_out_underconstrained(others.select(group), build)
    except DegenerateError:
        return None
    covariance = rig_covariance(found.sample, found.rig, found.placed.matches, config)
    return found if np.rad2deg(covariance.rotation_sigma.max()) < most_deg else None


def _others(observed: Observed, view: int, config: Config) -> Observed:
    """Return what the other cameras saw, in a large rig those that were paired with the view."""
    names = observed.recording.names
    if takes_all_pairs(len(names), config.view_graph):
        return observed.without(names[view])
    paired = [{pair.a, pair.b} - {view} for pair in observed.pairs if view in (pair.a, pair.b)]
    return observed.select(np.array(sorted(set().union(*paired)), dtype=np.int64))


def _build(observed: Observed, config: Config) -> OtherCameras:
    """Return the rig of these cameras: average -> match -> adjust -> triangulate."""
    sample, lifted = observed.sample, observed.lifted
    averaged = average(observed.recording.cameras, observed.pairs, config.averaging)
    matches = associate(sample, lifted, averaged.rig, config, progress=silent)
    adjusted = adjust_until_stable(
        sample, averaged.rig, matches, config, lifted=lifted, progress=silent
    )
    scores = [pair.score for pair in observed.pairs]
    placed = PlacedCameras.of(sample, adjusted.rig, adjusted.matches, config)
    return OtherCameras(sample, placed, pair_score=float(np.mean(scores)))


def pose_beside(others: CameraRig, rig: CameraRig, name: str) -> Floats:
    """Return the pose `[3, 4]` of a camera in the world of others, all of the same rig."""
    view, same = rig.names.index(name), [rig.names.index(other) for other in others.names]
    turn = nearest_rotation(np.einsum("vji,vjk->ik", others.rotation, rig.rotation[same]))
    theirs, ours = others.centres, rig.centres[same] @ turn.T
    scale = np.linalg.norm(theirs - theirs.mean(0)) / np.linalg.norm(ours - ours.mean(0))
    centre = theirs.mean(0) + scale * (turn @ rig.centres[view] - ours.mean(0))
    rotation = rig.rotation[view] @ turn.T
    return np.column_stack([rotation, -rotation @ centre])
