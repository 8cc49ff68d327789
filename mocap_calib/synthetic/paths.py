"""Where people walk: smooth paths through a room, with turns and pauses, on which nobody runs into anybody."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mocap_calib.synthetic.signals import wander
from mocap_calib.types import Floats

_STEP = 0.02  # metres between the points of a path
_APART = 0.8  # metres that people keep between them
_CANDIDATES = 60


@dataclass(frozen=True)
class Walk:
    """One person's way.

    position: `[time, 2]` metres; heading: `[time]` radians, unwrapped; speed: `[time]` m/s; pauses: (start, end) in
    seconds of standing still.
    """

    position: Floats
    heading: Floats
    speed: Floats
    pauses: tuple[tuple[float, float], ...]


def walks(
    rng: np.random.Generator, time: Floats, individuals: int, room: tuple[float, float]
) -> list[Walk]:
    """One walk an individual; of several candidates the one that keeps most away from those already there."""
    chosen: list[Walk] = []
    for _ in range(individuals):
        best = _walk(rng, time, room)
        for _ in range(_CANDIDATES):
            if _elbow_room(best, chosen) >= 1.0:
                break
            best = max(best, _walk(rng, time, room), key=lambda walk: _elbow_room(walk, chosen))
        chosen.append(best)
    return chosen


def _elbow_room(candidate: Walk, others: list[Walk]) -> float:
    """1 where the candidate always keeps its distance, else less."""
    if not others:
        return 1.0
    distance = np.min(
        [np.linalg.norm(candidate.position - other.position, axis=1) for other in others], axis=0
    )
    return float(1.0 - (np.maximum(1.0 - distance / _APART, 0.0) ** 2).mean())


def _walk(rng: np.random.Generator, time: Floats, room: tuple[float, float]) -> Walk:
    """Speeds and pauses are laid out along the path, then turned into a time at each point of it."""
    usual = rng.uniform(0.55, 1.35)
    path = _path(rng, room, 1.6 * usual * (time[-1] - time[0]) + 3.0)
    arc = np.linspace(0.0, _STEP * (len(path) - 1), len(path))
    tangent = np.gradient(path, _STEP, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    curvature = np.abs(gaussian_filter1d(np.gradient(heading, _STEP), 5))
    speed = np.minimum(
        usual * np.exp(0.15 * wander(rng, arc, 3.0)), 1.2 / np.maximum(curvature, 0.1)
    )  # at most 1.2 rad/s
    at = np.cumsum(rng.uniform(2.0, 7.0, int(arc[-1] // 2) + 1)) - rng.uniform(0.0, 5.0)
    at = at[(at > 0.5) & (at < arc[-1] - 0.5)]
    for stop in at:
        speed = np.minimum(
            speed, np.sqrt(2 * 0.7 * np.abs(arc - stop)) + 0.02
        )  # braking at 0.7 m/s^2
    arrival = time[0] + np.concatenate([[0.0], np.cumsum(_STEP / speed[1:])])
    pauses = []
    for stop in at:
        dwell = rng.uniform(0.8, 3.0)
        begin = float(np.interp(stop, arc, arrival))
        arrival = np.where(arc > stop, arrival + dwell, arrival)
        pauses.append((begin, begin + dwell))
    return _timed(time, arrival=arrival, path=path, heading=heading, pauses=tuple(pauses))


def _timed(
    time: Floats,
    *,
    arrival: Floats,
    path: Floats,
    heading: Floats,
    pauses: tuple[tuple[float, float], ...],
) -> Walk:
    """The path as a function of time; the smoothing takes the kinks out of starting and stopping."""
    arc, interval = np.linspace(0.0, _STEP * (len(path) - 1), len(path)), time[1] - time[0]
    along = gaussian_filter1d(np.interp(time, arrival, arc), 0.12 / interval, mode="nearest")
    position = np.stack([np.interp(along, arc, path[:, k]) for k in (0, 1)], axis=-1)
    turned = gaussian_filter1d(np.interp(along, arc, heading), 0.15 / interval, mode="nearest")
    return Walk(position, turned, np.gradient(along, interval), pauses)


def _path(rng: np.random.Generator, room: tuple[float, float], length: float) -> Floats:
    """`[point, 2]` points every 2 cm on a polyline through the room, its corners rounded; it stays in the room."""
    corners = [rng.uniform(-0.5, 0.5, 2) * room]
    direction = rng.normal(size=2)
    total = 0.0
    while total < length:
        options = rng.uniform(-0.5, 0.5, (8, 2)) * room
        leg = options - corners[-1]
        far = np.linalg.norm(leg, axis=1)
        cosine = leg @ direction / (far * np.linalg.norm(direction) + 1e-9)
        # people seldom turn on their heel, and seldom go but a step
        best = int(np.argmax(cosine + 0.8 * np.minimum(far, 2.0) + rng.normal(0.0, 0.3, 8)))
        corners.append(options[best])
        direction = leg[best]
        total += 0.8 * float(far[best])
    polyline = np.array(corners)
    dense = _resampled(polyline)
    return _resampled(gaussian_filter1d(dense, 0.4 / _STEP, axis=0, mode="nearest"))


def _resampled(points: Floats) -> Floats:
    """Points every 2 cm along a polyline."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    fine = np.arange(0.0, arc[-1], _STEP)
    return np.stack([np.interp(fine, arc, points[:, k]) for k in (0, 1)], axis=-1)
