"""Give results the coordinates that were asked for: scale, up, floor, origin and heading."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import WORLDS, CueConfig, FloorConfig, ScaleCue, WorldConfig
from mocap_calib.errors import DegenerateError, MismatchError
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.recording.epochs import views_by_camera
from mocap_calib.results import CalibrationResult, GroupResult, Poses3D
from mocap_calib.types import METRES, CameraRig, Floats, World
from mocap_calib.world.alignment import (
    align_to_cameras,
    align_to_landmarks,
    describe_alignment,
)
from mocap_calib.world.asked import camera_pair, joint_pair
from mocap_calib.world.body import (
    Joints,
    distance,
    joints_of_recording,
    keep_triangulated,
    median_over_frames,
    quantile_over_frames,
)
from mocap_calib.world.cues import Measurable, Scale, find_scale, scaled_world
from mocap_calib.world.floor import Floor, find_floor
from mocap_calib.world.moving import Similarity, move_group

_METRES = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048}


@dataclass(frozen=True)
class Placement:
    """Where to move results, and what is known of the coordinates then."""

    by: Similarity
    unit: str
    world: World


def place_result(result: CalibrationResult) -> CalibrationResult:
    """Return the result with each group in the coordinates that its configuration asks for.

    A group whose cameras or subjects do not allow that has others, and lengths that are arbitrary:
    `World.axes_unmet` and `World.scale_unmet` say why.
    """
    config = result.config.world
    groups = []
    for number, group in enumerate(result.groups):
        own = replace(config, cues=_cues_of_group(config.cues, result.groups, number))
        groups.append(place_in_world(group, own))
    return replace(result, groups=tuple(groups))


def place_in_world(group: GroupResult, config: WorldConfig) -> GroupResult:
    """Return a group of cameras and all that is known of it in the coordinates asked for."""
    joints = joints_of_recording(group.recording)
    poses = keep_triangulated(group.poses)
    floor = look_for_floor(group.poses, joints, group.rig, group.verdict, config.floor)
    covariance = group.uncertainty.covariance
    if isinstance(floor, Floor):
        turn = float(np.median(covariance.rotation_sigma))
        floor = replace(floor, up_sigma=float(np.hypot(floor.up_sigma, turn)))
    on = Measurable(poses, joints, group.rig, floor, covariance)
    placement = find_placement(on, config)
    return move_group(group, placement.by, placement.unit, placement.world)


def look_for_floor(
    poses: Poses3D, joints: Joints, rig: CameraRig, verdict: str, config: FloorConfig
) -> Floor | str:
    """Return the floor below poses, or why there is none.

    Of a long recording at most 10,000 frames are looked at, of those that show somebody.

    verdict: on the rig, "" where nobody judged it.
    """
    if verdict == "not determined":
        return "the rig is not determined"
    # as they were seen: best estimates lift or lower feet a little, for the sake of bones
    seen = replace(poses, positions=poses.raw)
    somebody = mapped.in_blocks(
        lambda block: np.isfinite(poses.raw[block, ..., 0]).any((1, 2)), len(poses.frames)
    )
    frames = mapped.some_frames(np.flatnonzero(somebody))
    return find_floor(seen.select(frames=frames), joints, rig, config)


def find_placement(on: Measurable, config: WorldConfig) -> Placement:
    """Return where to move cameras and poses, and what is known of the coordinates then.

    What cannot be had is left out, and the world says why.
    """
    scale, scale_unmet = None, ""
    try:
        scale = find_scale(config.cues, on, config.measure, config.floor)
    except MismatchError as error:
        scale_unmet = str(error)
    try:
        placement = _find_axes(on, config)
    except (MismatchError, DegenerateError) as error:
        plain = replace(config, axes="auto", cameras=(), landmarks=(), forward="")
        placement = _find_axes(on, plain)
        unmet = replace(placement.world, axes_unmet=str(error))
        placement = replace(placement, world=unmet)
    placement = _with_floor(_with_scale(placement, scale), on)
    return replace(placement, world=replace(placement.world, scale_unmet=scale_unmet))


def _find_axes(on: Measurable, config: WorldConfig) -> Placement:
    """Return the way to the axes that are asked for, with lengths as those say them.

    Raises MismatchError and DegenerateError where they cannot be had.
    """
    if config.landmarks:
        by, sigma, seen = align_to_landmarks(on.rig, config.landmarks, config, on.covariance)
        doubts = _check_people(on, by, "m", "--align", config.measure)
        remarks = (describe_alignment(seen), *doubts)
        world = World(kind="landmarks", scale_sigma=sigma, remarks=remarks, landmarks=seen)
        return Placement(by, "m", world)
    if config.cameras:
        by, sigma, remark = align_to_cameras(on.rig, config, on.covariance)
        return Placement(by, config.unit, _world_of_file(on, by, sigma, remark, config))
    if isinstance(on.floor, Floor) and config.axes in ("auto", "floor"):
        return Placement(_stand_on_floor(on, on.floor, config), on.poses.unit, World(kind="floor"))
    if config.axes == "floor" or config.forward:
        option = f"--forward {config.forward}" if config.forward else "--world floor"
        raise MismatchError(
            f"{option}: expected subjects that show a floor, found that {on.floor}; "
            "leave it out, or name a camera with --world"
        )
    return _look_through_camera(on, config)


def _world_of_file(
    on: Measurable, by: Similarity, sigma: float, remark: str, config: WorldConfig
) -> World:
    """Return what is known of the world of a file of cameras.

    by: the way to it. sigma: of the scale. remark: on the alignment. Raises MismatchError.
    """
    if config.unit not in METRES:
        return World(kind="file", remarks=(remark,))
    doubts = _check_people(on, by, config.unit, "--world", config.measure)
    return World(kind="file", scale_sigma=sigma, remarks=(remark, *doubts))


def _stand_on_floor(on: Measurable, floor: Floor, config: WorldConfig) -> Similarity:
    """Return the way to axes with z up, the origin on the floor below the middle of the bodies."""
    ahead = _heading(on, floor.up, config)
    ahead = ahead - (ahead @ floor.up) * floor.up
    ahead = ahead / np.linalg.norm(ahead)
    rotation = nearest_rotation(np.stack([np.cross(ahead, floor.up), ahead, floor.up]))
    points = mapped.some_frames(on.poses.positions).reshape(-1, 3)
    middle = np.array([_median_of_known(points[:, axis]) for axis in range(3)])
    origin = middle - ((middle - floor.point) @ floor.up) * floor.up
    return Similarity(1.0, rotation, -rotation @ origin)


def _median_of_known(values: Floats) -> float:
    """Return the median of the values `[N]` that are finite."""
    return float(np.median(mapped.finite_values(values), overwrite_input=True))


def _heading(on: Measurable, up: Floats, config: WorldConfig) -> Floats:
    """Return the direction `[3]` that is ahead; its part along up is left out afterwards.

    Raises MismatchError where the joints that say it are not seen, or lie above each other.
    """
    if not config.forward:
        looking, image_up = on.rig.rotation[0, 2], -on.rig.rotation[0, 1]
        steep = abs(looking @ up) > 0.98  # a camera that looks down: what is above in its image
        return np.asarray(image_up if steep else looking)
    a, b = joint_pair(config.forward, on.poses.keypoints, on.joints, "--forward")
    direction = (on.poses.positions[:, :, b] - on.poses.positions[:, :, a]).reshape(-1, 3)
    direction = direction[np.isfinite(direction[:, 0])]
    level = direction - (direction @ up)[:, None] * up
    length = np.linalg.norm(level, axis=1)
    level = level[length > 0] / length[length > 0, None]
    ahead = np.median(level, axis=0) if len(level) else np.zeros(3)
    if np.linalg.norm(ahead - (ahead @ up) * up) < 0.1:
        raise MismatchError(
            f"--forward {config.forward}: expected joints that mostly lie one way, found them all "
            "ways or not at all; leave it out"
        )
    return np.asarray(ahead)


def _look_through_camera(on: Measurable, config: WorldConfig) -> Placement:
    """Return the way to the axes of a camera: the first, unless one is named.

    Raises MismatchError where the camera was left out.
    """
    views = {name: own[0] for name, own in views_by_camera(on.rig.names).items()}
    named = config.axes not in WORLDS
    if named and config.axes not in views:
        raise MismatchError(
            f"--world {config.axes}: expected a camera of the rig, one of {', '.join(views)}, "
            "found one that could not be placed; name another"
        )
    name = config.axes if named else next(iter(views))
    rotation, translation = on.rig.rotation[views[name]], on.rig.translation[views[name]]
    world = World(kind="camera", camera=name, remarks=(f"the axes are those of camera {name}",))
    return Placement(Similarity(1.0, rotation, translation), on.poses.unit, world)


def _with_scale(placement: Placement, scale: Scale | None) -> Placement:
    """Return the placement with lengths in metres, where something says how long they are."""
    if scale is None:
        return placement
    by = placement.by  # to a world whose lengths may differ from those that were measured
    moved = Similarity(scale.factor, by.rotation, scale.factor / by.scale * by.shift)
    return Placement(moved, "m", scaled_world(placement.world, scale))


def _with_floor(placement: Placement, on: Measurable) -> Placement:
    """Return the placement whose world says what is up and where the floor is."""
    by, world = placement.by, placement.world
    if isinstance(on.floor, str):
        remarks = (*world.remarks, f"floor not determined: {on.floor}")
        return replace(placement, world=replace(world, remarks=remarks))
    remark = (
        "up and the floor are from the feet; up is uncertain by "
        f"{np.degrees(on.floor.up_sigma):.1f} deg, a standard deviation"
    )
    up, point = by.rotation @ on.floor.up, by.apply(on.floor.point)
    if world.kind == "floor":
        up, point = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    world = replace(
        world,
        up=up,
        up_sigma=on.floor.up_sigma,
        floor=point,
        floor_sigma=by.scale * on.floor.sigma,
        remarks=(remark, *world.remarks),
    )
    return replace(placement, world=world)


def _cues_of_group(
    cues: Sequence[ScaleCue], groups: Sequence[GroupResult], number: int
) -> tuple[ScaleCue, ...]:
    """Return the cues that are of a group: individuals by number are those of the largest.

    A distance of cameras that no group has is one of the largest, which complains of it.
    """
    own = []
    for cue in cues:
        of = 0 if cue.kind == "height" and cue.of else number
        if cue.kind == "camera distance":
            of = next((k for k, group in enumerate(groups) if _has_cameras(group, cue)), 0)
        if of == number:
            own.append(cue)
    return tuple(own)


def _has_cameras(group: GroupResult, cue: ScaleCue) -> bool:
    """Return whether both cameras of a cue are in a group."""
    try:
        camera_pair(cue.of, group.rig.names, "")
    except MismatchError:
        return False
    return True


# --- the stated unit, by the size of people


def _check_people(
    on: Measurable, by: Similarity, unit: str, option: str, config: CueConfig
) -> tuple[str, ...]:
    """Return a remark where people would be too small in a stated world, none where all is well.

    by: the way there. unit: of lengths in it. option: that states it.

    Raises MismatchError where they would be taller than anybody is.
    """
    seen = _tallness(on, config)
    if not len(seen):
        return ()
    tall = METRES[unit] * by.scale * float(np.median(seen))
    if tall > config.statures[1]:
        raise MismatchError(
            f"{option}: expected lengths in {unit}, found people {tall:.4g} m tall; "
            f"{_likely_unit(tall, config)}"
        )
    if tall < config.least_tall:
        return (f"people are {tall:.2g} m tall: is {option} in {unit}?",)
    return ()


def _tallness(on: Measurable, config: CueConfig) -> Floats:
    """Return how far heads are from ankles `[N]` of all whose are seen, about a stature."""
    joints, positions = on.joints, on.poses.positions
    ankles = joints.present(("left_ankle", "right_ankle"))
    if joints.kind != "people":
        return np.zeros(0)
    found = [np.full(positions.shape[1], np.nan)]
    for name, share in config.head_height:
        for head in joints.present([name]):
            for ankle in ankles:
                apart = distance(positions, head, ankle) / share
                enough = np.isfinite(apart).sum(0) >= config.least_frames
                far = quantile_over_frames(apart, config.tall_quantile)
                found.append(np.where(enough, far, np.nan))
    tall = median_over_frames(np.array(found))
    return tall[np.isfinite(tall)]


def _likely_unit(tall: float, config: CueConfig) -> str:
    """Return what to do about lengths that make people so many metres tall."""
    least, most = config.statures
    fits = {name: tall * metres for name, metres in _METRES.items()}
    fits = {name: metres for name, metres in fits.items() if least <= metres <= most}
    if not fits:
        return "correct the lengths"
    name = min(fits, key=lambda each: abs(np.log(fits[each] / config.usual_stature)))
    return f"were {name} meant? multiply them by {_METRES[name]:g}"
