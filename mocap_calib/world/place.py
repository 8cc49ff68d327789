"""Check requested coordinates, and move results to them: scale, up, floor, origin and heading."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import WORLDS, ScaleCue, WorldConfig
from mocap_calib.errors import DegenerateError, MismatchError, argument, spell_as_option, suggest
from mocap_calib.geometry.rotation import Similarity, nearest_rotation
from mocap_calib.recording.epochs import own_names, views_by_camera
from mocap_calib.results import CalibrationResult, GroupResult, Poses3D, RigCovariance
from mocap_calib.types import METRES, CameraRig, Floats, Recording, World
from mocap_calib.world.align import (
    align_to_cameras,
    align_to_landmarks,
    check_landmarks,
    stated_rig,
)
from mocap_calib.world.floor import (
    NO_FEET,
    Floor,
    Joints,
    joints_of_recording,
)
from mocap_calib.world.lengths import (
    Measurable,
    camera_pair,
    check_cues,
    check_unit,
    find_scale,
    joint_pair,
    measurable,
    scaled_world,
)


def check_world(config: WorldConfig, recording: Recording, individuals: int | None = None) -> None:
    """Check the requested coordinates and lengths against a recording.

    individuals: how many there are at most, None = not known.

    Raises MismatchError for unknown joints, cameras, axes and individuals, requests that exclude
    each other, and a floor or a stature of bodies without feet.
    """
    cameras = own_names(recording.names)
    joints = joints_of_recording(recording)
    _check_axes(config, cameras, joints)
    if config.forward:
        joint_pair(config.forward, recording.keypoints, joints, "forward")
    known_scale = config.landmarks or (config.cameras and config.unit in METRES)
    if config.cues and known_scale:
        raise MismatchError(
            "scale",
            "lengths from one source",
            "known lengths and a world in a known unit",
            f"leave out {argument('height')}, {argument('length')} and "
            f"{argument('camera_distance')}",
        )
    names = (recording.keypoints, joints, recording.names)
    check_cues(config.cues, *names, config.measure, count=individuals)


def _check_axes(config: WorldConfig, cameras: Sequence[str], joints: Joints) -> None:
    """Raise MismatchError for unknown axes, and a floor below bodies without feet."""
    if config.cameras:
        stated_rig(config.cameras, cameras)
    elif config.axes not in (*WORLDS, *cameras):
        offered = ", ".join((*WORLDS, *cameras))
        raise MismatchError(
            argument("world"),
            f"one of {offered}, or a file",
            f"{config.axes!r}",
            suggest(config.axes, (*WORLDS, *cameras)),
        )
    if config.landmarks:
        check_landmarks(config.landmarks, cameras, config)
    on_floor = not config.cameras and not config.landmarks and config.axes in ("auto", "floor")
    if config.forward and not on_floor:
        raise MismatchError(
            argument("forward"),
            "a world on the floor",
            "another",
            f"leave out {argument('forward')}, {argument('world')} or {argument('align')}",
        )
    if (config.forward or config.axes == "floor") and not joints.have_feet:
        option = argument("forward") if config.forward else argument("world", "floor")
        raise MismatchError(
            option,
            "subjects that show a floor",
            f"that {NO_FEET} (of people, or of animals on four legs)",
            "leave it out",
        )


@dataclass(frozen=True)
class Placement:
    """A similarity to new coordinates, their unit, and the world that they are."""

    by: Similarity
    unit: str
    world: World


def place_result(result: CalibrationResult) -> CalibrationResult:
    """Return the result with each group in the coordinates that its configuration requests.

    Where cameras or subjects do not allow that, a group has those of "auto", and arbitrary lengths:
    `World.axes_unmet` and `World.scale_unmet` have the reason.
    """
    config = result.config.world
    groups = []
    for number, group in enumerate(result.groups):
        own = replace(config, cues=_cues_of_group(config.cues, result.groups, number))
        groups.append(place_in_world(group, own))
    return replace(result, groups=tuple(groups))


def place_in_world(group: GroupResult, config: WorldConfig) -> GroupResult:
    """Return a group of cameras with its poses and covariances in the requested coordinates."""
    covariance = group.uncertainty.covariance
    joints = joints_of_recording(group.recording)
    on = measurable(group.poses, joints, group.rig, covariance, config, verdict=group.verdict)
    placement = find_placement(on, config)
    return move_group(group, placement.by, placement.unit, placement.world)


def find_placement(on: Measurable, config: WorldConfig) -> Placement:
    """Return the way to the requested coordinates, and the world that they are.

    Axes and lengths that the results do not allow are left out, and the world has the reason.
    """
    scale, scale_unmet = None, ""
    try:
        scale = find_scale(config.cues, on, config)
    except MismatchError as error:
        scale_unmet = error.render(spell_as_option)
    try:
        placement = _find_axes(on, config)
    except (MismatchError, DegenerateError) as error:
        plain = replace(config, axes="auto", cameras=(), landmarks=(), forward="")
        placement = _find_axes(on, plain)
        unmet = replace(placement.world, axes_unmet=error.render(spell_as_option))
        placement = replace(placement, world=unmet)
    if scale is not None:
        by = placement.by  # whose lengths may differ from those that were measured
        by = Similarity(scale.factor, by.rotation, scale.factor / by.scale * by.shift)
        placement = Placement(by, "m", scaled_world(placement.world, scale))
    placement = _with_floor(placement, on)
    return replace(placement, world=replace(placement.world, scale_unmet=scale_unmet))


def _find_axes(on: Measurable, config: WorldConfig) -> Placement:
    """Return the way to the requested axes, in their unit of length.

    Raises MismatchError and DegenerateError where the results do not allow them.
    """
    if config.landmarks or config.cameras:
        return _stated_axes(on, config)
    if isinstance(on.floor, Floor) and config.axes in ("auto", "floor"):
        by = _way_to_floor(on, on.floor, config)
        return Placement(by, on.poses.unit, World(kind="floor"))
    if config.axes == "floor" or config.forward:
        option = (
            argument("forward", config.forward) if config.forward else argument("world", "floor")
        )
        raise MismatchError(
            option,
            "subjects that show a floor",
            f"that {on.floor}",
            f"leave it out, or use {argument('world', 'CAMERA')}",
        )
    return _look_through_camera(on, config)


def _stated_axes(on: Measurable, config: WorldConfig) -> Placement:
    """Return the way to the world of landmarks, or of cameras of known pose.

    Raises MismatchError where these do not fit the rig, or people do not fit their unit.
    """
    align = align_to_landmarks if config.landmarks else align_to_cameras
    by, sigma, world = align(on.rig, config, on.covariance)
    name, unit = ("align", "m") if config.landmarks else ("world", config.unit)
    if unit in METRES:
        metres = METRES[unit] * by.scale * on.poses.positions
        doubts = check_unit(metres, on.joints, name, config.measure)
        world = replace(world, scale_sigma=sigma, remarks=(*world.remarks, *doubts))
    return Placement(by, unit, world)


def _way_to_floor(on: Measurable, floor: Floor, config: WorldConfig) -> Similarity:
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
    """Return the forward direction `[3]`; the caller takes its part along up off.

    Raises MismatchError where the joints that define it are missing, or above each other.
    """
    if not config.forward:
        looking, image_up = on.rig.rotation[0, 2], -on.rig.rotation[0, 1]
        steep = abs(looking @ up) > 0.98  # a camera that looks down: what is above in its image
        return np.asarray(image_up if steep else looking)
    a, b = joint_pair(config.forward, on.poses.keypoints, on.joints, "forward")
    direction = (on.poses.positions[:, :, b] - on.poses.positions[:, :, a]).reshape(-1, 3)
    direction = direction[np.isfinite(direction[:, 0])]
    level = direction - (direction @ up)[:, None] * up
    length = np.linalg.norm(level, axis=1)
    level = level[length > 0] / length[length > 0, None]
    ahead = np.median(level, axis=0) if len(level) else np.zeros(3)
    if np.linalg.norm(ahead - (ahead @ up) * up) < 0.1:
        raise MismatchError(
            argument("forward", config.forward),
            "joints that mostly lie in one direction",
            "them in all directions or not at all",
            "leave it out",
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
            argument("world", config.axes),
            f"a camera of the rig, one of {', '.join(views)}",
            "one that was left out of it",
            "name another",
        )
    name = config.axes if named else next(iter(views))
    rotation, translation = on.rig.rotation[views[name]], on.rig.translation[views[name]]
    world = World(kind="camera", camera=name, remarks=(f"the axes are those of camera {name}",))
    return Placement(Similarity(1.0, rotation, translation), on.poses.unit, world)


def _with_floor(placement: Placement, on: Measurable) -> Placement:
    """Return the placement whose world has up and the floor."""
    by, world = placement.by, placement.world
    if isinstance(on.floor, str):
        remarks = (*world.remarks, f"floor not determined: {on.floor}")
        return replace(placement, world=replace(world, remarks=remarks))
    remark = (
        "up and the floor follow from the feet; uncertainty of up (1 SD): "
        f"{np.degrees(on.floor.up_sigma):.1f} deg"
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
    """Return the cues of a group. Numbers of individuals are those of the largest group.

    A distance of cameras that are in no group counts as one of the largest, which refuses it.
    """

    def group_of(cue: ScaleCue) -> int:
        """Return the number of the group that a cue is of."""
        for k, group in enumerate(groups if cue.kind == "camera distance" else ()):
            with suppress(MismatchError):
                camera_pair(cue.of, group.rig.names, "")
                return k
        return number if cue.kind == "length" or not cue.of else 0

    return tuple(cue for cue in cues if group_of(cue) == number)


def move_rig(rig: CameraRig, by: Similarity, unit: str, world: World) -> CameraRig:
    """Return a rig in other coordinates, whose unit and world are said."""
    rotation = rig.rotation @ by.rotation.T
    if not np.array_equal(rotation, rig.rotation):
        rotation = nearest_rotation(rotation)  # a file holds it to the last digit
    translation = by.scale * rig.translation - rotation @ by.shift
    return replace(rig, rotation=rotation, translation=translation, unit=unit, world=world)


def move_poses(poses: Poses3D, by: Similarity, unit: str, world: World) -> Poses3D:
    """Return poses in other coordinates, whose unit and world are said."""
    return replace(poses.scale(by.scale, unit).turn(by.rotation, by.shift), world=world)


def move_covariance(covariance: RigCovariance, by: Similarity) -> RigCovariance:
    """Return the covariance of a rig in other coordinates: its axes turn, its size scales."""
    turn = np.kron(np.eye(2), by.rotation)  # turns of the cameras, and shifts of their centres
    matrix = np.einsum("ij,vjwk,lk->viwl", turn, covariance.matrix, turn)
    return replace(covariance, matrix=matrix, size=by.scale * covariance.size)


def move_group(group: GroupResult, by: Similarity, unit: str, world: World) -> GroupResult:
    """Return all that is known of a group of cameras in other coordinates.

    A rig reversed in depth stays where it is: nothing of it was measured.
    """
    covariance = move_covariance(group.uncertainty.covariance, by)
    return replace(
        group,
        averaged=replace(group.averaged, rig=move_rig(group.averaged.rig, by, unit, world)),
        adjusted=replace(group.adjusted, rig=move_rig(group.rig, by, unit, world)),
        uncertainty=replace(group.uncertainty, covariance=covariance),
        poses=move_poses(group.poses, by, unit, world),
    )
