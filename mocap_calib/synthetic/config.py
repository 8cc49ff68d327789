"""Synthetic scenes: what is simulated, and how animals move."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class AnimalMotion:
    """How a kind of animal goes about in synthetic scenes.

    unit: metres of a length of 1 in the section `body` of its skeleton's file.
    room: size of the room that it needs, as a share of one for people.
    moving, resting: names of the postures that it holds.
    stride: lengths of 1 that it goes in a cycle of its gait. beats: cycles a second besides, of
        wings. height: above the floor, as a share of what is usual in a room for people, in
        metres; 0 = it walks.
    """

    unit: float
    room: float
    moving: tuple[str, ...]
    resting: tuple[str, ...]
    stride: float = float("inf")
    beats: float = 0.0
    height: float = 0.0


ANIMAL_MOTION = {
    "quadruped": AnimalMotion(0.6, 0.5, ("walk", "trot"), ("stand",), stride=1.6),  # a dog
    "rodent": AnimalMotion(0.14, 0.16, ("walk",), ("stand", "groom"), stride=0.7),  # a rat
    "bird": AnimalMotion(0.2, 0.35, ("flap",), ("glide",), beats=2.5, height=1.0),  # a pigeon
}


@dataclass(frozen=True)
class SimulateConfig:
    """A synthetic recording. Lengths in metres; all move in a square 0.9 radii wide.

    animals: pairs (kind of ANIMAL_MOTION, number).
    radius: None: 4.5 where there are people, less where the animals need less room.
    """

    cameras: int = 4
    people: int = 3
    animals: tuple[tuple[str, int], ...] = ()
    frames: int = 200
    fps: float = 30.0
    radius: float | None = None
    arc_deg: float = 360.0  # less than a full ring makes narrower baselines
    size: tuple[int, int] = (1280, 720)  # (width, height)
    distortion: Literal["none", "brown", "fisheye"] = "none"
    layout: Literal["coco17", "all"] = "coco17"  # of people
    noise_px: float = 2.0  # RMS of a coordinate
    missing: float = 0.05  # share of joints
    outliers: float = 0.01  # share of joints
    false_detections: float = 0.05  # share of frames, in each view
    shuffle: bool = True
    seed: int = 0

    @property
    def kinds_of_animals(self) -> tuple[str, ...]:
        """The kind of each animal."""
        return tuple(kind for kind, number in self.animals for _ in range(number))

    @property
    def scale(self) -> float:
        """The size of the room, as a share of one for people."""
        if self.people:
            return 1.0
        return max((ANIMAL_MOTION[kind].room for kind in self.kinds_of_animals), default=1.0)

    @property
    def ring_radius(self) -> float:
        """From the middle of the room to the cameras."""
        return USUAL_RADIUS * self.scale if self.radius is None else self.radius


# recordings to begin with (`mocap-calib example`), each made within a second
EXAMPLES = {
    "people": SimulateConfig(people=2, frames=100, distortion="brown"),
    "dog": SimulateConfig(people=0, animals=(("quadruped", 1),), frames=100, distortion="brown"),
    "mouse": SimulateConfig(people=0, animals=(("rodent", 1),), frames=100, distortion="brown"),
}

USUAL_RADIUS = 4.5  # metres from the middle of a room for people to the cameras

CAMERA_HEIGHT = 2.2  # metres in a room for people: above people's heads, as cameras hang in rooms

CAMERA_AIM = (0.0, 0.0, 0.9)  # metres: the middle of the people in the room

ROOM_SIDE = 0.9  # side of the square that people walk in, in radii of the ring

PEOPLE_APART = 0.8  # metres that people keep between them

FALSE_COPIES = 0.5  # share of the false detections that are a distorted copy of a real one

FALSE_CONFIDENCE = 0.7  # of the confidence of a real detection

WALK_CANDIDATES = 60  # walks tried for each person, until one keeps away from the others

MOTION_RATE = 60.0  # inner frames a second: steps must not depend on how often somebody looks
