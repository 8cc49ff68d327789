"""Which axis points up in poses, and turning them so that another one does."""

from dataclasses import replace

import numpy as np

from mocap_calib.geometry.rotation import skew
from mocap_calib.io.poses import PoseFile
from mocap_calib.types import Floats

# axis that points up -> rotation of the world that makes it y
_UP = {
    "x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    "-y": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
}
UP_AXES = tuple(_UP)


def turn_up_axis(file: PoseFile, up: str) -> PoseFile:
    """Turn the poses so that the axis that points up is y, as OpenSim and others take it.

    up: x, y, z, -x, -y or -z; the other axes follow. What the file itself says of up is forgotten.
    """
    turned = _turn(file, np.array(_UP[up], dtype=np.float64))
    world = replace(turned.poses.world, up=np.array([0.0, 1.0, 0.0]))
    return replace(turned, poses=replace(turned.poses, world=world))


def turn_upright(file: PoseFile, axis: str) -> PoseFile:
    """Turn the poses so that what is up is this axis, where the poses say what is up.

    axis: y or z; with another, or where nobody says what is up, the axes stay. From the axes of
    the world that are nearest to up to those of the file is a change of axes alone, (X, Y, Z) ->
    (Y, Z, X) for z up and y wanted; the rest is the smallest turn.
    """
    up = file.poses.world.up
    if axis not in ("y", "z") or not np.isfinite(up).all():
        return file
    nearest = max(_UP, key=lambda name: float(_direction(name) @ up))
    turn = np.array(_UP[nearest], dtype=np.float64)
    if axis == "z":  # from y to z: back, as z to y is
        turn = np.array(_UP["z"], dtype=np.float64).T @ turn
    rest = turn_between(turn @ up, _direction(axis))
    if np.array_equal(rest @ turn, np.eye(3)):
        return file
    return _turn(file, rest @ turn)


def up_axis(file: PoseFile) -> str:
    """Return the axis of the file that points up (x, -y, ...), "" where none does, or nobody says.

    Within half a degree, which no reader tells from the axis.
    """
    up = file.poses.world.up
    return next((axis for axis in _UP if _direction(axis) @ up > np.cos(np.radians(0.5))), "")


def _direction(axis: str) -> Floats:
    """Return the unit vector `[3]` along an axis: x, -y, ..."""
    found = np.zeros(3)
    found["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return found


def _turn(file: PoseFile, rotation: Floats) -> PoseFile:
    """Return poses and cameras in other axes, to which a rotation `[3, 3]` turns those there."""
    rig = file.rig
    if rig is not None:
        turned = rig.rotation @ rotation.T
        rig = replace(rig, rotation=turned, world=rig.world.turn(rotation))
    return replace(file, poses=file.poses.turn(rotation), rig=rig)


def turn_between(first: Floats, second: Floats) -> Floats:
    """Return the smallest rotations `[..., 3, 3]` that turn vectors `[..., 3]` to along others.

    Of any length. Opposite ones are turned about any axis across; where one of them has no length,
    nothing is.
    """
    a = _unit(first)
    b = _unit(second)
    cosine = (a * b).sum(-1)[..., None, None]
    axis = np.cross(a, b)
    # R = I + [v]x + [v]x^2 / (1 + cos), v = a x b; a half turn is 2 u u' - I, u across
    across = np.cross(a, np.eye(3)[np.abs(a).argmin(-1)])
    across = _unit(across)
    half_turn = 2 * across[..., :, None] * across[..., None, :] - np.eye(3)
    opposite = cosine < -1 + 1e-12
    crossed = skew(axis)
    usual = np.eye(3) + crossed + crossed @ crossed / np.where(opposite, 1.0, 1 + cosine)
    return np.where(opposite, half_turn, usual)


def _unit(vector: Floats) -> Floats:
    """Return vectors `[..., 3]` at length 1; those without length as they are."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.where(length > 0, length, 1.0), dtype=np.float64)
