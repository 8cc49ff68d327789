"""A whole recording with its truth, from one seed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.synthetic.animals import move_animal
from mocap_calib.synthetic.bodies import motion_times, move_person
from mocap_calib.synthetic.config import ANIMAL_MOTION, CAMERA_HEIGHT, ROOM_SIDE, SimulateConfig
from mocap_calib.synthetic.detections import LAYOUTS, Detections, detect, keypoint_files
from mocap_calib.synthetic.paths import plan_walks
from mocap_calib.synthetic.rigs import ring_rig
from mocap_calib.types import CameraRig, Floats, Ints, Keypoints2D, Record


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
    rig = ring_rig(
        rng_rig,
        cameras=config.cameras,
        radius=config.ring_radius / config.scale,
        height=CAMERA_HEIGHT,
        size=config.size,
        distortion=config.distortion,
        arc_deg=config.arc_deg,
    )
    detections = detect(
        rng_detector,
        rig,
        _join_bodies(bodies, kinds, joints, detected),
        layout=_join_names(detected),
        noise_px=config.noise_px,
        missing=config.missing,
        outliers=config.outliers,
        false_detections=config.false_detections,
        shuffle=config.shuffle,
    )
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
    """Raise MismatchError where there is nobody, no time, or a kind of animal that is not known."""
    unknown = sorted(set(config.kinds_of_animals) - set(ANIMAL_MOTION))
    if unknown:
        raise MismatchError(
            "simulate",
            f"animals of the kinds {', '.join(ANIMAL_MOTION)}",
            ", ".join(unknown),
            "choose among those",
        )
    if min(config.people + len(config.kinds_of_animals), config.frames, config.fps) <= 0:
        raise MismatchError(
            "simulate",
            "people or animals, and frames and fps above 0",
            f"{config.people} people and {len(config.kinds_of_animals)} animals, "
            f"{config.frames} frames, {config.fps} fps",
            "raise what is 0",
        )
