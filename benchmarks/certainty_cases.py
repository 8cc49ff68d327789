"""Make simulated recordings with known rigs: sound ones, and ones that determine no rig.

The same number gives the same case.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from mocap_calib.front import from_keypoints
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import looking_along, matrix_from_vector
from mocap_calib.io.camera_files import read_cameras, read_rig
from mocap_calib.io.keypoints import read_keypoints
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.synthetic.detections import LAYOUTS, detect, keypoint_files
from mocap_calib.synthetic.scene import Scene, simulate
from mocap_calib.types import CameraRig, Floats, Ints, Keypoints2D, Recording

ANIMALS = ("quadruped", "rodent", "bird")
ANIMAL_SHARE = 0.25  # of the scenes; the others show people
NOISE_PX = (1.0, 2.0, 4.0)
FRAMES = 60  # of the cases that may not determine a rig
LENGTHS = (60, 120)  # frames of the others
TIMES_AS_FAR = (4, 10, 30)  # with focal lengths as many times as long
STILL_NOISE_PX = 0.1  # of a detector that sees the same picture again
TURNED_DEG = (0, 2, 6)  # of a camera from facing the other one
COPIES = ((0.0, 0), (0.0, 5), (0.5, 0), (2.0, 0))  # noise that is added in pixels, frames of delay
PERMUTED = (
    "frames of all cameras",
    "frames of one camera",
    "instances of all cameras",
    "joints of all cameras",
    "joints of one camera",
)
PERMUTED_FPS = 5.0  # bodies are elsewhere in most of the other frames then
THICKNESS = (0.0, 0.02)  # of what lies in a plane, as a share of what it was
SIMULATED = 9  # of the seeds of sound scenes
PARTS = ((2, 2), (3, 1), (3, 2), (3, 3))  # cameras of recordings that have nothing in common


@dataclass(frozen=True)
class Case:
    """One recording, which is made or read where it is needed."""

    name: str
    kind: str
    make: Callable[[], "Files"]


@dataclass(frozen=True)
class Files:
    """Keypoint files, and the true rigs of their cameras.

    truth: of cameras that belong together; there is no true rig of cameras of several.
    """

    views: tuple[Keypoints2D, ...]
    truth: tuple[CameraRig, ...]

    def record(self) -> Recording:
        """Return the recording of all files, with the intrinsics of the rigs' cameras.

        Raises MocapCalibError where that is refused.
        """
        cameras = [camera for rig in self.truth for camera in rig.cameras]
        return from_keypoints(self.views, cameras)

    def change(self, function: Callable[[Keypoints2D], Keypoints2D]) -> "Files":
        """Return other files of the same cameras."""
        return replace(self, views=tuple(map(function, self.views)))


def simulated_cases(count: int) -> Iterator[Case]:
    """Yield sound recordings of all sorts: cameras, subjects, kinds, noise, length."""
    for number in range(count):
        rng = np.random.default_rng([number, SIMULATED])
        yield Case(f"simulated-{number}", "simulated", partial(any_scene, rng))


def degenerate_cases(count: int) -> Iterator[Case]:
    """Yield as many cases of each of the `KINDS`, the kinds in turns."""
    for number in range(count):
        for place, (kind, make) in enumerate(KINDS.items()):
            rng = np.random.default_rng([number, place])
            name = f"{kind}-{number}".replace(" ", "_")
            yield Case(name, kind, partial(make, rng, number))


def recorded_case(recording: Path) -> Case:
    """Return the case of a real recording."""
    return Case(recording.name, "recorded", partial(read_files, recording))


def read_files(recording: Path) -> Files:
    """Return the files of a real recording, with the intrinsics that a run gets."""
    reference = read_rig(recording / "reference.toml")
    cameras = {camera.name: camera for camera in read_cameras(recording / "intrinsics.toml")}
    truth = replace(reference, cameras=tuple(cameras[name] for name in reference.names))
    return Files(read_keypoints([recording / "keypoints"]), (truth,))


def any_scene(rng: np.random.Generator) -> Files:
    """Return a sound recording: any number of cameras and subjects, any kind, noise and length."""
    config = choose_scene(rng, cameras=(3, 8), subjects=(1, 4))
    return files_of(simulate(replace(config, frames=int(rng.choice(LENGTHS)))))


# What determines a rig, or not: each takes a generator and the number of the case of its kind


def sound(rng: np.random.Generator, _: int) -> Files:
    """Return a recording that determines its rig."""
    return files_of(simulate(choose_scene(rng)))


def near_affine(rng: np.random.Generator, number: int) -> Files:
    """Return a recording through telephoto lenses from afar: perspective hardly shows."""
    config = choose_scene(rng)
    scene = simulate(config)
    factor = TIMES_AS_FAR[number % len(TIMES_AS_FAR)]
    middle = np.nanmean(scene.poses, axis=(0, 1, 2))
    away = factor * (scene.rig.centres - middle)
    rig = scene.rig.stand(looking_along(-away, np.array([0.0, 0.0, -1.0])), middle + away)
    longer = (change_intrinsics(each, log_focal=np.log(factor), k1=0.0) for each in rig.cameras)
    rig = replace(rig, cameras=tuple(longer))
    return Files(film(rng, rig, scene, scene.poses, config.noise_px), (rig,))


def static(rng: np.random.Generator, number: int) -> Files:
    """Return a recording in which nobody moves; in every second one the noise does not either."""
    config = choose_scene(rng, subjects=(1, 2))
    scene = simulate(config)
    poses = np.repeat(scene.poses[FRAMES // 2][None], FRAMES, axis=0)
    files = Files(film(rng, scene.rig, scene, poses, config.noise_px), (scene.rig,))
    if number % 2:
        first = np.zeros(FRAMES, int)
        return files.change(lambda view: blur(rng, show(view, first), STILL_NOISE_PX))
    return files


def flat(rng: np.random.Generator, number: int) -> Files:
    """Return a recording in which all that is seen lies in a plane, or nearly."""
    config = choose_scene(rng, subjects=(1, 2))
    scene = simulate(config)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    off = scene.poses - np.nanmean(scene.poses, axis=(0, 1, 2))
    share = 1 - THICKNESS[number % len(THICKNESS)]
    poses = scene.poses - share * (off @ normal)[..., None] * normal
    return Files(film(rng, scene.rig, scene, poses, config.noise_px), (scene.rig,))


def facing_pair(rng: np.random.Generator, number: int) -> Files:
    """Return a recording of two cameras that face each other, or nearly."""
    config = choose_scene(rng, cameras=(2, 2))
    scene = simulate(config)
    degrees = 180 + TURNED_DEG[number % len(TURNED_DEG)]
    turn = matrix_from_vector(np.deg2rad(degrees) * np.array([0.0, 0.0, 1.0]))
    rotation, centre = scene.rig.rotation[0], scene.rig.centres[0]
    rotations, centres = np.stack([rotation, rotation @ turn.T]), np.stack([centre, turn @ centre])
    rig = scene.rig.stand(rotations, centres)
    return Files(film(rng, rig, scene, scene.poses, config.noise_px), (rig,))


def few_frames(rng: np.random.Generator, number: int) -> Files:
    """Return one to three frames of a recording."""
    files = files_of(simulate(choose_scene(rng, subjects=(1, 4))))
    frames = np.sort(rng.choice(FRAMES, 1 + number % 3, replace=False))
    return files.change(lambda view: show(view, frames))


def duplicate(rng: np.random.Generator, number: int) -> Files:
    """Return a recording in which the file of a camera is there twice, under two names.

    Its camera is given twice as well: the second one stands where the first does.
    """
    files = files_of(simulate(choose_scene(rng)))
    (rig,) = files.truth
    noise_px, delay = COPIES[number % len(COPIES)]
    copy = show(files.views[0], np.maximum(np.arange(FRAMES) - delay, 0))
    copy = replace(blur(rng, copy, noise_px), camera=rig.names[1])
    where = [0, 0, *range(2, len(rig.names))]
    pairs = zip(where, rig.names, strict=True)
    same = replace(
        rig,
        cameras=tuple(replace(rig.cameras[view], name=name) for view, name in pairs),
        rotation=rig.rotation[where],
        translation=rig.translation[where],
    )
    return Files((files.views[0], copy, *files.views[2:]), (same,))


def noise_only(rng: np.random.Generator, number: int) -> Files:
    """Return a recording of nothing: joints anywhere, or in every second one in clouds."""
    spread = (0.5, 0.08)[number % 2]
    return files_of(simulate(choose_scene(rng))).change(lambda view: scatter(rng, view, spread))


def permuted(rng: np.random.Generator, number: int) -> Files:
    """Return a recording in which frames, instances or joints are not those that they seem."""
    slow = replace(choose_scene(rng, subjects=(2, 3)), fps=PERMUTED_FPS)
    files = files_of(simulate(slow))
    what = PERMUTED[number % len(PERMUTED)]
    names = tuple(rng.permutation(files.views[0].keypoints).tolist())

    def change(view: Keypoints2D) -> Keypoints2D:
        if what.endswith("one camera") and view.camera != files.views[0].camera:
            return view
        if what.startswith("frames"):
            return show(view, rng.permutation(FRAMES))
        # the order of instances is random as it is: now the file says that it means something
        return replace(view, keypoints=names) if "joints" in what else replace(view, tracked=True)

    return files.change(change)


def unrelated(rng: np.random.Generator, number: int) -> Files:
    """Return the cameras of two recordings as if they were those of one."""
    views: list[Keypoints2D] = []
    rigs = []
    for part, cameras in enumerate(PARTS[number % len(PARTS)]):
        config = choose_scene(rng, cameras=(cameras, cameras), animals=False)
        files = files_of(simulate(config))
        rig = rename(files.truth[0], [f"part{part}-{name}" for name in files.truth[0].names])
        rigs.append(rig)
        views += (replace(v, camera=name) for v, name in zip(files.views, rig.names, strict=True))
    return Files(tuple(views), tuple(rigs))


KINDS: dict[str, Callable[[np.random.Generator, int], Files]] = {
    "sound": sound,
    "near affine": near_affine,
    "static": static,
    "facing pair": facing_pair,
    "1 to 3 frames": few_frames,
    "duplicate": duplicate,
    "noise only": noise_only,
    "permuted": permuted,
    "unrelated": unrelated,
    "flat": flat,
}


# Steps


def choose_scene(
    rng: np.random.Generator,
    *,
    cameras: tuple[int, int] = (3, 5),
    subjects: tuple[int, int] = (1, 3),
    animals: bool = True,
) -> SimulateConfig:
    """Return a scene of one kind of subjects; cameras, subjects: the least and the most."""
    count = int(rng.integers(*subjects, endpoint=True))
    kind = str(rng.choice(ANIMALS)) if animals and rng.random() < ANIMAL_SHARE else ""
    return SimulateConfig(
        cameras=int(rng.integers(*cameras, endpoint=True)),
        people=0 if kind else count,
        animals=((kind, count),) if kind else (),
        frames=FRAMES,
        noise_px=float(rng.choice(NOISE_PX)),
        seed=int(rng.integers(10**6)),
    )


def files_of(scene: Scene) -> Files:
    """Return the files and the rig of a scene as it is."""
    return Files(scene.files, (scene.rig,))


def film(
    rng: np.random.Generator, rig: CameraRig, scene: Scene, poses: Floats, noise_px: float
) -> tuple[Keypoints2D, ...]:
    """Return what a detector makes of the poses of a scene in the images of another rig."""
    joints = LAYOUTS["coco17"] if scene.kinds[0] == "people" else scene.joints
    detections = detect(rng, rig, poses, joints, SimulateConfig(noise_px=noise_px))
    return keypoint_files(rig, detections)


def rename(rig: CameraRig, names: Sequence[str]) -> CameraRig:
    """Return the rig with other names of its cameras."""
    named = (replace(camera, name=name) for camera, name in zip(rig.cameras, names, strict=True))
    return replace(rig, cameras=tuple(named))


def show(view: Keypoints2D, source: Ints) -> Keypoints2D:
    """Return the view whose frames, counted from 0, are these of its frames."""
    return replace(
        view,
        frames=np.arange(len(source)),
        positions=view.positions[source],
        confidence=view.confidence[source],
    )


def blur(rng: np.random.Generator, view: Keypoints2D, noise_px: float) -> Keypoints2D:
    """Return the view with noise in addition to what it has."""
    return replace(
        view, positions=view.positions + noise_px * rng.normal(size=view.positions.shape)
    )


def scatter(rng: np.random.Generator, view: Keypoints2D, spread: float) -> Keypoints2D:
    """Return the view with joints anywhere around the middle of each detection's own cloud.

    spread: half the side of a cloud, in sizes of the image.
    """
    size, shape = np.array(view.image_size), view.positions.shape
    middle = rng.uniform(spread, 1 - spread, (*shape[:2], 1, 2))
    joints = (middle + rng.uniform(-spread, spread, shape)) * size
    return replace(view, positions=np.where(np.isfinite(view.positions), joints, np.nan))
