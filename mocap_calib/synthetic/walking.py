"""How people walk: smooth paths on which nobody runs into anybody, and feet that stand.

The phase of the gait counts cycles (two steps) and is driven by the travelled distance, so that
nobody walks on the spot. Each foot stands at one place for 62 % of its cycle (Winter 2009, ch. 1)
and swings to the next one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from mocap_calib.synthetic.config import PEOPLE_APART, WALK_CANDIDATES
from mocap_calib.synthetic.signals import direction, ease, interpolate, left_of, wander
from mocap_calib.types import Floats

_STEP = 0.02  # metres between the points of a path
_TURN_RATE = 1.2  # radians a second at most
_BRAKING = 0.7  # metres a second squared
_LEAST_SPEED = 0.02  # metres a second, where somebody stops

_STANCE = 0.62  # share of the cycle that a foot stands
_PASSING = 0.31  # phase at which the pelvis is above the foot
_BOTH_DOWN = 0.06  # a phase at which both feet stand, half-way through double support
_TURN_PER_CYCLE = 2.4  # radians: who turns on the spot steps as well, about 70 degrees a step
_STEP_WIDTH = 0.075  # metres from the middle to each foot
_TOES_OUT_DEG = 7.0

# pitch of the foot in degrees over its cycle, heel up positive: heel strike, flat, heel off, toe
# off, swing
_PITCH = PchipInterpolator(
    [0.0, 0.09, 0.36, 0.50, 0.62, 0.74, 0.90, 1.0],
    [-16.0, 0.0, 0.0, 14.0, 42.0, 30.0, -10.0, -16.0],
)

Pauses = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Walk:
    """One person's way.

    position: `[time, 2]` metres.
    heading: `[time]` radians, unwrapped.
    speed: `[time]` metres a second.
    pauses: (start, end) in seconds of standing still.
    """

    position: Floats
    heading: Floats
    speed: Floats
    pauses: Pauses


def plan_walks(
    rng: np.random.Generator,
    time: Floats,
    individuals: int,
    room: tuple[float, float],
    others: Sequence[Walk] = (),
) -> list[Walk]:
    """Return a walk for each individual.

    Of several candidates, the one that keeps most away from those already there. time: `[time]`
    seconds; room: (width, depth) in metres about the origin; others: who is there before.
    """
    walks = list(others)
    for _ in range(individuals):
        best_room = -1.0
        for _ in range(1 + WALK_CANDIDATES):
            candidate = _plan_walk(rng, time, room)
            elbow_room = _elbow_room(candidate, walks)
            if elbow_room > best_room:
                best, best_room = candidate, elbow_room
            if best_room >= 1.0:
                break
        walks.append(best)
    return walks[len(others) :]


def _elbow_room(candidate: Walk, others: list[Walk]) -> float:
    """Return 1 where the candidate always keeps its distance from the others, else less."""
    if not others:
        return 1.0
    distances = [np.linalg.norm(candidate.position - walk.position, axis=1) for walk in others]
    intrusion = np.maximum(1.0 - np.min(distances, axis=0) / PEOPLE_APART, 0.0)
    return float(1.0 - (intrusion**2).mean())


def _plan_walk(rng: np.random.Generator, time: Floats, room: tuple[float, float]) -> Walk:
    """Lay out speeds and pauses along a random path, then find the time at each point of it."""
    usual_speed = rng.uniform(0.55, 1.35)
    enough = 1.6 * usual_speed * (time[-1] - time[0]) + 3.0
    path = _random_path(rng, room, enough)
    arc = _arc_length(path)
    tangent = np.gradient(path, _STEP, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    curvature = np.abs(gaussian_filter1d(np.gradient(heading, _STEP), 5))
    speed = usual_speed * np.exp(0.15 * wander(rng, arc, 3.0))
    speed = np.minimum(speed, _TURN_RATE / np.maximum(curvature, 0.1))
    stops = _random_stops(rng, arc[-1])
    for stop in stops:
        braking = np.sqrt(2 * _BRAKING * np.abs(arc - stop)) + _LEAST_SPEED
        speed = np.minimum(speed, braking)
    duration = np.concatenate([[0.0], np.cumsum(_STEP / speed[1:])])
    arrival, pauses = _pause(rng, time[0] + duration, arc, stops)
    return _walk_in_time(time, arrival=arrival, path=path, heading=heading, pauses=pauses)


def _random_stops(rng: np.random.Generator, length: float) -> Floats:
    """Return where on a path of this length somebody stops, `[stop]` metres."""
    gaps = rng.uniform(2.0, 7.0, int(length // 2) + 1)
    stops = np.cumsum(gaps) - rng.uniform(0.0, 5.0)
    return stops[(stops > 0.5) & (stops < length - 0.5)]


def _arc_length(path: Floats) -> Floats:
    """Return how far along a path `[point, 2]` each point `[point]` is, in metres."""
    return np.linspace(0.0, _STEP * (len(path) - 1), len(path))


def _pause(
    rng: np.random.Generator, arrival: Floats, arc: Floats, stops: Floats
) -> tuple[Floats, Pauses]:
    """Return the times of arrival `[point]` with pauses of random length at the stops `[stop]`."""
    pauses = []
    for stop in stops:
        dwell = rng.uniform(0.8, 3.0)
        begin = float(np.interp(stop, arc, arrival))
        arrival = np.where(arc > stop, arrival + dwell, arrival)
        pauses.append((begin, begin + dwell))
    return arrival, tuple(pauses)


def _walk_in_time(
    time: Floats, *, arrival: Floats, path: Floats, heading: Floats, pauses: Pauses
) -> Walk:
    """Return a path `[point, 2]` as a function of time.

    arrival: `[point]` seconds; heading: `[point]`. The smoothing takes the kinks out of starting
    and stopping.
    """
    arc = _arc_length(path)
    interval = time[1] - time[0]
    along = gaussian_filter1d(np.interp(time, arrival, arc), 0.12 / interval, mode="nearest")
    position = interpolate(along, arc, path)
    turned = gaussian_filter1d(np.interp(along, arc, heading), 0.15 / interval, mode="nearest")
    return Walk(position, turned, np.gradient(along, interval), pauses)


def _random_path(rng: np.random.Generator, room: tuple[float, float], length: float) -> Floats:
    """Return points `[point, 2]` every 2 cm on a path through the room, and within it.

    A polyline of about `length` metres at least, its corners rounded.
    """
    corners = [rng.uniform(-0.5, 0.5, 2) * room]
    ahead = rng.normal(size=2)
    total = 0.0
    while total < length:
        options = rng.uniform(-0.5, 0.5, (8, 2)) * room
        leg = options - corners[-1]
        distance = np.linalg.norm(leg, axis=1)
        cosine = leg @ ahead / (distance * np.linalg.norm(ahead) + 1e-9)
        # people seldom turn on their heel, and seldom go but a step
        liking = cosine + 0.8 * np.minimum(distance, 2.0) + rng.normal(0.0, 0.3, 8)
        best = int(np.argmax(liking))
        corners.append(options[best])
        ahead = leg[best]
        total += 0.8 * float(distance[best])  # rounding the corners shortens the way
    polyline = _resample(np.array(corners))
    return _resample(gaussian_filter1d(polyline, 0.4 / _STEP, axis=0, mode="nearest"))


def _resample(points: Floats) -> Floats:
    """Return points `[point, 2]` every 2 cm along a polyline `[corner, 2]`."""
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(legs)])
    even = np.arange(0.0, arc[-1], _STEP)
    return interpolate(even, arc, points)


# --- the gait


@dataclass(frozen=True)
class Foot:
    """A foot over time.

    ankle: `[time, 3]` metres.
    yaw: `[time]` radians.
    pitch: `[time]` radians; above 0 lifts the heel.
    """

    ankle: Floats
    yaw: Floats
    pitch: Floats


def gait_cycles(time: Floats, walk: Walk, stature: float) -> Floats:
    """Return the gait cycles `[time]` since the start.

    All pauses fall where both feet are on the floor. time: `[time]` seconds; stature: metres.
    """
    stride = (0.5 + 0.62 * np.maximum(walk.speed, 0.0)) * stature / 1.7  # longer when faster
    walking = (walk.speed / stride)[1:] * np.diff(time)
    turning = np.abs(np.diff(walk.heading)) / _TURN_PER_CYCLE
    cycles: Floats = np.concatenate([[0.0], np.cumsum(walking + turning)])
    if not walk.pauses:
        return cycles
    return _pause_on_both_feet(cycles, time, walk)


def _pause_on_both_feet(cycles: Floats, time: Floats, walk: Walk) -> Floats:
    """Return the cycles `[time]`, shifted a little so that both feet stand in every pause."""
    middle = np.array([(start + end) / 2 for start, end in walk.pauses])
    paused: Floats = np.interp(middle, time, cycles)
    paused = paused[np.concatenate([[True], np.diff(paused) > 0.3])]
    wanted = np.round(2 * (paused - _BOTH_DOWN)) / 2 + _BOTH_DOWN
    # between pauses the phase is stretched a little, outside of them only shifted
    outside = cycles[-1] + 1.0
    before = np.concatenate([[paused[0] - outside], paused, [paused[-1] + outside]])
    after = np.concatenate([[wanted[0] - outside], wanted, [wanted[-1] + outside]])
    return np.asarray(np.interp(cycles, before, after))


def vigour(walk: Walk) -> Floats:
    """Return how large the swings of legs and arms are `[time]`: 0 standing .. 1 brisk."""
    brisk = ease(0.15 + 0.7 * walk.speed / 1.1)
    moving = ease(walk.speed / 0.4)
    return np.asarray(brisk * moving)


def place_foot(walk: Walk, cycles: Floats, side: float, offsets: Floats) -> Foot:
    """Return the left (side = 1) or right (side = -1) foot over time.

    cycles: `[time]` of `gait_cycles`. offsets: `[3, 3]` heel, big toe and small toe from the ankle,
    in metres, of a flat foot in its own axes (x ahead, y left, z up).
    """
    own_cycles = cycles - (0.0 if side > 0 else 0.5)
    step = np.floor(own_cycles)
    within = own_cycles - step
    swing_phase = (within - _STANCE) / (1 - _STANCE)
    swing = ease(swing_phase)
    here, yaw_here = _foothold(walk, own_cycles, step, side)
    following, yaw_following = _foothold(walk, own_cycles, step + 1, side)
    strength = vigour(walk)
    yaw = yaw_here + swing * (yaw_following - yaw_here)
    pitch = strength * np.radians(_PITCH(within))
    rolled = _roll_over(within, swing, strength, offsets)
    moved = swing[:, None] * (following - here)
    level = here + moved + rolled[:, None] * direction(yaw)
    arch = np.sin(np.pi * np.clip(swing_phase, 0, 1)) ** 2
    clearance = (0.02 + 0.04 * strength) * arch
    # the lowest point of the turned foot is what stands on the floor; heel and toes are joints
    # inside of it
    sine, cosine = np.sin(pitch)[:, None], np.cos(pitch)[:, None]
    lowest = (-sine * offsets[:, 0] + cosine * offsets[:, 2]).min(1)
    height = clearance - lowest + float(-0.35 * offsets[0, 2])
    return Foot(np.concatenate([level, height[:, None]], axis=1), yaw, pitch)


def _roll_over(within: Floats, swing: Floats, strength: Floats, offsets: Floats) -> Floats:
    """Return how far `[time]` the ankle is ahead of its foothold as the foot rolls, in metres.

    within: `[time]` phase of the foot's own cycle; swing: `[time]` 0..1 of the way to the next
    foothold; strength: `[time]` of `vigour`.
    """
    standing = _ankle_shift(strength * np.radians(_PITCH(within)), offsets)
    lift = _ankle_shift(strength * np.radians(float(_PITCH(_STANCE))), offsets)
    land = _ankle_shift(strength * np.radians(float(_PITCH(0.0))), offsets)
    return np.where(within < _STANCE, standing, lift + swing * (land - lift))


def _ankle_shift(pitch: Floats, offsets: Floats) -> Floats:
    """Return how far `[time]` the ankle goes ahead when the foot is pitched, in metres.

    The foot rolls over its toe, or stands back on its heel.
    """
    pivot = np.where(np.asarray(pitch)[..., None] > 0, offsets[1], offsets[0])
    turned = np.cos(pitch) * pivot[..., 0] + np.sin(pitch) * pivot[..., 2]
    return np.asarray(pivot[..., 0] - turned)


def _foothold(walk: Walk, own_cycles: Floats, step: Floats, side: float) -> tuple[Floats, Floats]:
    """Return where the foot stands in its step number `[time]`, and its heading.

    Beside where the pelvis passes, `[time, 2]` metres, and `[time]` radians.
    """
    # a slight slope makes the phase strictly increasing, also while somebody stands
    index = np.arange(len(own_cycles), dtype=np.float64)
    passing = np.interp(step + _PASSING, own_cycles + 1e-9 * index, index)
    place = interpolate(passing, index, walk.position)
    heading = np.interp(passing, index, walk.heading)
    left = left_of(direction(heading))
    yaw = heading + side * np.radians(_TOES_OUT_DEG)
    return place + _STEP_WIDTH * side * left, yaw
