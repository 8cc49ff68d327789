"""Give results the coordinates that were asked for: scale, up, floor, origin and heading."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import WORLDS, ScaleCue, WorldConfig
from mocap_calib.errors import MismatchError, suggest
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.recording.epochs import own_names, views_by_camera
from mocap_calib.recording.joints import choose_skeleton
from mocap_calib.steerpose.weights import load_vocabulary
from mocap_calib.types import (
    METRES,
    CalibrationResult,
    CameraRig,
    Floats,
    GroupResult,
    Recording,
    World,
)
from mocap_calib.world.alignment import (
    align_to_cameras,
    align_to_landmarks,
    describe_alignment,
    shared_cameras,
)
from mocap_calib.world.body import Joints, find_joints, keep_triangulated
from mocap_calib.world.cues import Measurable, Scale, camera_pair, find_scale, joint_pair
from mocap_calib.world.floor import Floor, find_floor
from mocap_calib.world.moving import Similarity, move_group


@dataclass(frozen=True, eq=False)
class Placement:
    """Where to move results, and what is known of the coordinates then."""

    by: Similarity
    unit: str
    world: World


def check_world(config: WorldConfig, recording: Recording) -> None:
    """Hold what is asked for to the names of a recording, before it is calibrated.

    Raises MismatchError for unknown joints, cameras and axes.
    """
    cameras = own_names(recording.names)
    if not config.cameras and config.axes not in (*WORLDS, *cameras):
        offered = ", ".join((*WORLDS, *cameras))
        raise MismatchError(
            f"--world: expected one of {offered}, or a file, found {config.axes!r}; "
            f"{suggest(config.axes, (*WORLDS, *cameras))}"
        )
    if config.cameras:
        shared_cameras(config.cameras, cameras)
    known_scale = config.landmarks or (config.cameras and config.unit in METRES)
    if config.cues and known_scale:
        raise MismatchError(
            "scale: expected lengths from one source, found known lengths beside a world that has "
            "its unit; leave out --height, --length and --camera-distance"
        )
    strangers = {each.camera for each in config.landmarks} - set(cameras)
    if strangers:
        raise MismatchError(
            f"--align: expected cameras of the recording ({', '.join(cameras)}), "
            f"found {min(strangers)!r}; {suggest(min(strangers), cameras)}"
        )
    _check_names(config, recording)


def _check_names(config: WorldConfig, recording: Recording) -> None:
    """Raise MismatchError for joints and cameras that the recording does not have."""
    joints = _joints_of(recording)
    rig = CameraRig(
        recording.cameras,
        np.tile(np.eye(3), (len(recording.cameras), 1, 1)),
        np.zeros((len(recording.cameras), 3)),
    )
    for cue in config.cues:
        if cue.kind == "length":
            joint_pair(cue.of, recording.keypoints, joints, "--length")
        elif cue.kind == "camera distance":
            camera_pair(cue.of, rig, "--camera-distance")
    if config.forward:
        if config.cameras or config.landmarks or config.axes not in ("auto", "floor"):
            raise MismatchError(
                "--forward: expected a world on the floor, whose heading it says, found another; "
                "leave it, --world or --align out"
            )
        joint_pair(config.forward, recording.keypoints, joints, "--forward")


def place_result(result: CalibrationResult) -> CalibrationResult:
    """Return the result with each group in the coordinates that its configuration asks for.

    What is asked for must be possible in the largest group; in others it is done where it is.

    Raises MismatchError where it is not possible, and where known lengths contradict each other.
    """
    config = result.config.world
    groups = []
    for number, group in enumerate(result.groups):
        own = replace(config, cues=_cues_of_group(config.cues, result.groups, number))
        try:
            groups.append(place_in_world(group, own))
        except MismatchError as error:
            if number == 0:
                raise
            plain = replace(config, axes="auto", cues=(), cameras=(), landmarks=(), forward="")
            groups.append(_remark(place_in_world(group, plain), str(error)))
    return replace(result, groups=tuple(groups))


def place_in_world(group: GroupResult, config: WorldConfig) -> GroupResult:
    """Return a group of cameras and all that is known of it in the coordinates asked for.

    Raises MismatchError as `place_result` does.
    """
    joints = _joints_of(group.recording)
    trusted = group.verdict != "not determined"
    poses = keep_triangulated(group.poses)
    floor: Floor | str = "the rig is not determined"
    if trusted:
        floor = find_floor(poses, joints, group.rig, config.floor)
    covariance = group.uncertainty.covariance
    if isinstance(floor, Floor):
        turn = float(np.median(covariance.rotation_sigma))
        floor = replace(floor, up_sigma=float(np.hypot(floor.up_sigma, turn)))
    on = Measurable(poses, joints, group.rig, floor, covariance)
    placement = find_placement(on, config)
    return move_group(group, placement.by, placement.unit, placement.world)


def find_placement(on: Measurable, config: WorldConfig) -> Placement:
    """Return where to move cameras and poses, and what is known of the coordinates then.

    Raises MismatchError where what is asked for is not possible.
    """
    if config.landmarks:
        by, sigma, seen = align_to_landmarks(on.rig, config.landmarks, config)
        remarks = (describe_alignment(seen),)
        world = World(kind="landmarks", scale_sigma=sigma, remarks=remarks, landmarks=seen)
        return _with_floor(Placement(by, "m", world), on)
    scale = find_scale(config.cues, on, config.measure, config.floor)
    if config.cameras:
        by, sigma = align_to_cameras(on.rig, config.cameras)
        remark = "aligned to cameras whose places were given"
        known = config.unit in METRES
        world = World(kind="file", scale_sigma=sigma if known else np.nan, remarks=(remark,))
        return _with_floor(_with_scale(Placement(by, config.unit, world), scale), on)
    if isinstance(on.floor, Floor) and config.axes in ("auto", "floor"):
        by = _stand_on_floor(on, on.floor, config)
        placement = Placement(by, on.poses.unit, World(kind="floor"))
    elif config.axes == "floor":
        raise MismatchError(
            f"--world floor: expected subjects that show a floor, found that {on.floor}; "
            "leave it out, or name a camera"
        )
    else:
        placement = _look_through_camera(on, config)
    return _with_floor(_with_scale(placement, scale), on)


def _stand_on_floor(on: Measurable, floor: Floor, config: WorldConfig) -> Similarity:
    """Return the way to axes with z up, the origin on the floor below the middle of the bodies."""
    ahead = _heading(on, floor.up, config)
    ahead = ahead - (ahead @ floor.up) * floor.up
    ahead = ahead / np.linalg.norm(ahead)
    rotation = nearest_rotation(np.stack([np.cross(ahead, floor.up), ahead, floor.up]))
    points = on.poses.positions.reshape(-1, 3)
    middle = np.median(points[np.isfinite(points[:, 0])], axis=0)
    origin = middle - ((middle - floor.point) @ floor.up) * floor.up
    return Similarity(1.0, rotation, -rotation @ origin)


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
    world = replace(placement.world, scale_sigma=scale.sigma, cues=scale.cues)
    return Placement(moved, "m", world)


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


def _joints_of(recording: Recording) -> Joints:
    """Return which keypoints of a recording are which joints."""
    skeleton = load_vocabulary(recording.model)
    columns = {
        skeleton.keypoints[joint]: k for k, joint in enumerate(recording.vocabulary) if joint >= 0
    }
    if not columns:
        return find_joints(recording.keypoints)
    return Joints(choose_skeleton(columns).name, columns)


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
        camera_pair(cue.of, group.rig, "")
    except MismatchError:
        return False
    return True


def _remark(group: GroupResult, remark: str) -> GroupResult:
    """Return a group whose coordinates have one more remark."""
    world = replace(group.rig.world, remarks=(*group.rig.world.remarks, remark))
    still = Similarity(1.0, np.eye(3), np.zeros(3))
    return move_group(group, still, group.rig.unit, world)
