"""Make a recording that the benchmarks read, of a publisher's files.

    .venv/bin/python benchmarks/recording_of_publisher.py OUT --cameras reference.toml
        --detections KEYPOINTS ...           # what a detector found of one subject
        --bodies FILE:ARRAY ... --joints ... # or 3D truth, an array for each subject: projected

Cameras and detections are in any format that the program reads (docs/formats.md); of 3D truth,
the cameras see points in their image with 3 px of noise, and order subjects at random.
benchmarks/README.md has the command of each recording, and says what OUT holds. OUT is new.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import make_parser
from paper.scenes import shuffled_view
from poses_of_arrays import names_of, read_clip

from mocap_calib.errors import MismatchError, MocapCalibError
from mocap_calib.io.camera_files import read_rig
from mocap_calib.io.keypoints import read_keypoints
from mocap_calib.synthetic.scene_files import write_scene
from mocap_calib.types import CameraRig, Floats, Ints, Keypoints2D


class Made(NamedTuple):
    """A recording as it is written; `mocap_calib.synthetic.scene_files` has the fields."""

    rig: CameraRig
    files: tuple[Keypoints2D, ...]
    identity: Ints
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    poses: Floats


def main() -> None:
    """Read what there is, and write a folder."""
    options = parse()
    try:
        rig = read_rig(options.cameras)
        if options.views:
            rig = rig.select(tuple(options.views.split(",")))
        command = shlex.join([Path(__file__).name, *sys.argv[1:]])
        write_scene(options.out, make(rig, options), command)
    except (MocapCalibError, OSError) as error:
        sys.exit(str(error))
    except KeyError as error:
        sys.exit(f"{options.cameras}: {error.args[0]}")


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = make_parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cameras", type=Path, required=True, help="where they stand, and lenses")
    parser.add_argument("--views", help="these cameras alone: names with commas")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--detections", nargs="+", help="files, folders, or name=path")
    source.add_argument("--bodies", nargs="+", metavar="FILE:ARRAY")
    parser.add_argument("--joints", default="", help="of --bodies: as poses_of_arrays.py has it")
    parser.add_argument("--key", default="", help="of --joints, likewise")
    parser.add_argument("--kind", default="people", help="people, quadruped, rodent or bird")
    parser.add_argument("--every", type=int, default=1, help="n-th frame of 3D truth")
    parser.add_argument("--frames", type=int, help="at most so many, of 3D truth")
    parser.add_argument("--noise", type=float, default=3.0, help="pixels, of 3D truth")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def make(rig: CameraRig, options: argparse.Namespace) -> Made:
    """Return the recording. Raises FormatError and MismatchError."""
    if options.detections:
        return of_detections(rig, read_keypoints(options.detections), options.kind)
    joints = tuple(names_of(options.joints, options.key))
    clips = [read_clip(source, len(joints)) for source in options.bodies]
    shortest = min(len(clip) for clip in clips)
    poses = np.stack([clip[:shortest] for clip in clips], 1)[:: options.every][: options.frames]
    rng = np.random.default_rng(options.seed)
    return project(rig, poses, joints, options.kind, noise=options.noise, rng=rng)


def of_detections(rig: CameraRig, files: Sequence[Keypoints2D], kind: str) -> Made:
    """Return a recording of one subject, with what a detector found.

    Raises MismatchError where a frame has two detections: their identities are unknown.
    """
    by_camera = {file.camera: file for file in files}
    ordered = tuple(by_camera[name] for name in rig.names)
    last = 1 + max(int(file.frames[-1]) for file in ordered)
    most = max(file.positions.shape[1] for file in ordered)
    ids = np.full((len(ordered), last, most), -1)
    for view, file in enumerate(ordered):
        seen = np.isfinite(file.positions).all(-1).any(-1)
        if (seen.sum(1) > 1).any():
            raise MismatchError(
                file.source, "one detection in a frame", "several", "keep one individual"
            )
        ids[view, file.frames, : seen.shape[1]] = np.where(seen, 0, -1)
    joints = ordered[0].keypoints
    return Made(rig, ordered, ids, joints, (kind,), np.full((last, 1, len(joints), 3), np.nan))


def project(
    rig: CameraRig,
    poses: Floats,
    joints: tuple[str, ...],
    kind: str,
    *,
    noise: float,
    rng: np.random.Generator,
) -> Made:
    """Return a recording of 3D truth `[frame, individual, joint, 3]`, in the unit of the rig."""
    frames, people = poses.shape[:2]
    ids, files = np.zeros((len(rig.cameras), frames, people), dtype=np.int64), []
    for view, camera in enumerate(rig.cameras):
        pixels, inside, order = shuffled_view(rng, rig, view, poses, noise)
        ids[view] = np.where(inside.any(-1), order, -1)
        files.append(
            Keypoints2D(
                camera=camera.name,
                keypoints=joints,
                frames=np.arange(frames),
                positions=np.where(inside[..., None], pixels, np.nan),
                confidence=inside.astype(float),
                tracked=False,
                image_size=camera.size,
                source=camera.name,
            )
        )
    return Made(rig, tuple(files), ids, joints, (kind,) * people, poses)


if __name__ == "__main__":
    main()
