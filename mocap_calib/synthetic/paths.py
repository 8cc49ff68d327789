"""Where people walk: smooth paths with turns and pauses, on which nobody runs into anybody."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mocap_calib.synthetic.config import PEOPLE_APART, WALK_CANDIDATES
from mocap_calib.synthetic.signals import interpolate, wander
from mocap_calib.types import Floats

_STEP = 0.02  # metres between the points of a path
_TURN_RATE = 1.2  # radians a second at most
_BRAKING = 0.7  # metres a second squared
_LEAST_SPEED = 0.02  # metres a second, where somebody stops

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
    direction = rng.normal(size=2)
    total = 0.0
    while total < length:
        options = rng.uniform(-0.5, 0.5, (8, 2)) * room
        leg = options - corners[-1]
        distance = np.linalg.norm(leg, axis=1)
        cosine = leg @ direction / (distance * np.linalg.norm(direction) + 1e-9)
        # people seldom turn on their heel, and seldom go but a step
        liking = cosine + 0.8 * np.minimum(distance, 2.0) + rng.normal(0.0, 0.3, 8)
        best = int(np.argmax(liking))
        corners.append(options[best])
        direction = leg[best]
        total += 0.8 * float(distance[best])  # rounding the corners shortens the way
    polyline = _resample(np.array(corners))
    return _resample(gaussian_filter1d(polyline, 0.4 / _STEP, axis=0, mode="nearest"))


def _resample(points: Floats) -> Floats:
    """Return points `[point, 2]` every 2 cm along a polyline `[corner, 2]`."""
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(legs)])
    even = np.arange(0.0, arc[-1], _STEP)
    return interpolate(even, arc, points)
