"""A whole recording with its truth, from one seed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.synthetic.animals import move_animal
from mocap_calib.synthetic.bodies import motion_times, move_person
from mocap_calib.synthetic.config import (
    ANIMAL_MOTION,
    CAMERA_AIM,
    CAMERA_HEIGHT,
    ROOM_SIDE,
    SimulateConfig,
)
from mocap_calib.synthetic.detections import LAYOUTS, Detections, detect, keypoint_files
from mocap_calib.synthetic.signals import direction, turn_about
from mocap_calib.synthetic.walking import plan_walks
from mocap_calib.types import Camera, CameraRig, Floats, Ints, Keypoints2D, Record

_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Record):
    """Detections, and the truth behind them.

    rig: in metres, +z up.
    kinds: `[individual]` "people", "quadruped", ...; the skeleton that has the joints.
    poses: `[frame, individual, joint, 3]` metres, of the joints `joints`, whatever the layout of
        the detections; NaN for joints that an individual does not have.
    """

    rig: CameraRig
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    poses: Floats
    detections: Detections

    @property
    def files(self) -> tuple[Keypoints2D, ...]:
        """What the detector's files hold, one a view."""
        return keypoint_files(self.rig, self.detections)

    @property
    def identity(self) -> Ints:
        """`[view, frame, instance]` who each detection is, -1 = nobody."""
        return self.detections.identity


def simulate(config: SimulateConfig = SimulateConfig()) -> Scene:
    """Return a scene of people and animals who go about among a ring of cameras.

    The same configuration gives the same bytes. People, rig, detector and animals draw from
    generators of their own: another noise leaves the bodies and the rig as they are.

    Raises MismatchError.
    """
    _check(config)
    rng_people, rng_rig, rng_detector, rng_animals = np.random.default_rng(config.seed).spawn(4)
    bodies = list(_move_bodies(config, rng_people, rng_animals))
    kinds = ("people",) * config.people + config.kinds_of_animals
    joints = {kind: load_skeleton(kind).keypoints for kind in dict.fromkeys(kinds)}
    detected = joints | ({"people": LAYOUTS[config.layout]} if config.people else {})
    rig = ring_rig(rng_rig, config)
    seen = _join_bodies(bodies, kinds, joints, detected)
    detections = detect(rng_detector, rig, seen, _join_names(detected), config)
    return Scene(
        rig=replace(rig, translation=rig.translation * config.scale),
        joints=_join_names(joints),
        kinds=kinds,
        poses=_join_bodies(bodies, kinds, joints, joints) * config.scale,
        detections=detections,
    )


def _move_bodies(
    config: SimulateConfig, rng_people: np.random.Generator, rng_animals: np.random.Generator
) -> Iterator[Floats]:
    """Yield the joints `[frame, joint, 3]` of the skeleton of each individual, people first.

    Lengths are those of the scene before it is scaled.
    """
    time, seen = motion_times(config.frames, config.fps)
    side = ROOM_SIDE * config.ring_radius / config.scale
    room = (side, side)
    walks = plan_walks(rng_people, time, config.people, room)
    for walk in walks:
        yield move_person(rng_people, time, walk)[seen]
    kinds = config.kinds_of_animals
    ways = plan_walks(rng_animals, time, len(kinds), room, walks)
    for kind, way in zip(kinds, ways, strict=True):
        yield move_animal(rng_animals, kind, time, way, scale=config.scale)[seen]


def _join_bodies(
    bodies: Sequence[Floats],
    kinds: Sequence[str],
    joints: Mapping[str, tuple[str, ...]],
    wanted: Mapping[str, tuple[str, ...]],
) -> Floats:
    """Return `[frame, individual, joint, 3]` of bodies `[frame, joint, 3]` of several kinds.

    kinds: of the bodies. joints: what the bodies of each kind have; wanted: what is taken of them.
    The joints are those of `_join_names(wanted)`, NaN where a kind has none of that name.
    """
    names = _join_names(wanted)
    joined = np.full((len(bodies[0]), len(bodies), len(names), 3), np.nan)
    for individual, (body, kind) in enumerate(zip(bodies, kinds, strict=True)):
        for joint in wanted[kind]:
            joined[:, individual, names.index(joint)] = body[:, joints[kind].index(joint)]
    return joined


def _join_names(joints: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Return the names of the joints of all kinds, each once."""
    return tuple(dict.fromkeys(name for names in joints.values() for name in names))


def _check(config: SimulateConfig) -> None:
    """Raise MismatchError where there is nobody, no time, or a setting is out of its range."""
    shares = ("missing", "outliers", "false_detections")
    accepted = {name: 0 <= getattr(config, name) <= 1 for name in shares} | {
        "animals": set(config.kinds_of_animals) <= set(ANIMAL_MOTION),
        "people": config.people + len(config.kinds_of_animals) > 0,
        "cameras": config.cameras > 0,
        "frames": config.frames > 0,
        "fps": config.fps > 0,
        "radius": config.radius is None or config.radius > 0,
        "size": min(config.size) > 0,
        "arc_deg": 0 <= config.arc_deg <= 360,
        "layout": config.layout in LAYOUTS,
        "noise_px": config.noise_px >= 0,
    }
    wrong = [f"{name} {getattr(config, name)}" for name, right in accepted.items() if not right]
    if wrong:
        raise MismatchError(
            "simulate",
            f"people or animals ({', '.join(ANIMAL_MOTION)}), numbers above 0, shares in 0..1, an "
            f"arc of 0..360 degrees, noise of 0 or more and layout {' or '.join(LAYOUTS)}",
            ", ".join(wrong),
            "correct that setting",
        )


# --- the rig


def ring_rig(rng: np.random.Generator, config: SimulateConfig) -> CameraRig:
    """Return a rig of cameras cam1, cam2, ... that stand around the middle of a room, in metres.

    All look at the middle, but no two alike: places, aims, focal lengths and rolls differ by a few
    per cent or degrees. The room is one for people, before it is scaled to that of animals.
    """
    cameras = config.cameras
    # a full ring has as many gaps as cameras, an arc one less
    gaps = cameras if config.arc_deg == 360 else max(cameras - 1, 1)
    start = rng.uniform(0, 2 * np.pi)
    place = np.arange(cameras) + rng.uniform(-0.1, 0.1, cameras)
    azimuth = start + np.radians(config.arc_deg) / gaps * place
    distance = config.ring_radius / config.scale * (1 + rng.uniform(-0.08, 0.08, cameras))
    up = CAMERA_HEIGHT * (1 + rng.uniform(-0.15, 0.15, cameras))
    level = distance[:, None] * direction(azimuth)
    centres = np.concatenate([level, up[:, None]], axis=-1)
    aims = np.array(CAMERA_AIM) + rng.normal(0, [0.25, 0.25, 0.1], (cameras, 3))
    roll = np.radians(rng.normal(0, 2.0, cameras))
    rotation = turn_about(roll) @ looking_along(aims - centres, _DOWN)
    translation = -np.einsum("vij,vj->vi", rotation, centres)
    made = tuple(_random_camera(rng, f"cam{k + 1}", config) for k in range(cameras))
    return CameraRig(made, rotation, translation, "m")


def _random_camera(rng: np.random.Generator, name: str, config: SimulateConfig) -> Camera:
    """Return a camera about 62 degrees wide, a fisheye about 105."""
    width, height = config.size
    fisheye = config.distortion == "fisheye"
    usual_focal = width * (0.55 if fisheye else 0.85)
    focal = usual_focal * rng.uniform(0.93, 1.07)
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    centre_x, centre_y = middle + rng.uniform(-0.01, 0.01, 2) * width
    focal_y = focal * rng.uniform(0.998, 1.002)
    matrix = np.array([[focal, 0, centre_x], [0, focal_y, centre_y], [0, 0, 1]])
    coefficients = _random_coefficients(rng, config.distortion)
    return Camera(name, config.size, matrix, coefficients, fisheye)


def _random_coefficients(rng: np.random.Generator, distortion: str) -> Floats:
    """Return distortion coefficients, as in OpenCV: `[5]`, or `[4]` of a fisheye.

    The distorted radius grows with the radius everywhere: nothing folds back into the image.
    Brown: 1 + 3 k1 r^2 + 5 k2 r^4 > 0 for all r, since 9 k1^2 < 20 k2. Fisheye: likewise up to 90
    degrees.
    """
    if distortion == "none":
        return np.zeros(5)
    if distortion == "brown":
        k1, k2 = rng.uniform(-0.28, -0.18), rng.uniform(0.06, 0.1)
        p1, p2 = rng.normal(0, 5e-4, 2)
        return np.array([k1, k2, p1, p2, 0.0])
    k1, k2 = rng.uniform(-0.04, -0.01), rng.uniform(-0.002, 0.002)
    return np.array([k1, k2, 0.0, 0.0])
