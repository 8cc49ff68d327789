"""Check that the programs that our files are for read them.

Each consumer is installed in an environment of its own.

    .venv/bin/python benchmarks/interop/run.py SCRATCH [consumer ...]

Writes one rig and one set of poses in every format to SCRATCH/files, and detections for SLEAP, with
the pixels and positions that must come out in expected.json; makes SCRATCH/env-CONSUMER with pip
(nothing is installed twice), runs checks/check_CONSUMER.py there, and prints a table: what was
read, by what, and the largest difference. docs/formats-checks.md holds the last run.
"""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras.formats import CAMERA_FORMATS
from mocap_calib.io.cameras.write import write_cameras
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.io.poses.common import PoseFile
from mocap_calib.io.poses.formats import POSE_FORMATS
from mocap_calib.io.poses.write import write_poses
from mocap_calib.results import Poses3D
from mocap_calib.types import Camera, CameraRig, Keypoints2D

HERE = Path(__file__).parent
CONSTRAINTS = (
    HERE.parents[1] / "constraints.txt"
)  # pins torch to what is no gigabyte of CUDA, should anything ask for it
# python: version, where the consumer needs another; alone: installed without its dependencies, most
# of which its readers do not use
CONSUMERS: dict[str, dict[str, list[str]]] = {
    "opencv": {"pip": ["opencv-python-headless", "numpy"]},
    "aniposelib": {
        "alone": ["aniposelib"],
        "pip": [
            "numpy",
            "opencv-contrib-python-headless<5",
            "toml",
            "numba",
            "scipy",
            "tqdm",
            "pandas",
            "jax",
        ],
    },
    "pycolmap": {"pip": ["pycolmap", "numpy"]},
    "pose2sim": {
        "alone": ["pose2sim"],
        "pip": [
            "numpy",
            "opencv-python-headless",
            "rtoml",
            "scipy",
            "pandas",
            "matplotlib",
            "c3d",
            "anytree",
            "tqdm",
            "lxml",
            "statsmodels",
            "filterpy",
        ],
    },
    "caliscope": {
        "alone": ["caliscope"],
        "pip": [
            "numpy",
            "opencv-python-headless",
            "rtoml",
            "scipy",
            "pandas",
            "pandera",
            "av",
            "platformdirs",
        ],
    },
    "c3d": {"pip": ["c3d", "numpy"]},
    "ezc3d": {"pip": ["ezc3d", "numpy"]},
    "opensim": {"pip": ["opensim", "numpy"]},
    "xarray": {"pip": ["xarray", "h5netcdf", "h5py", "numpy"]},
    "movement": {
        "python": ["3.12"],
        "alone": ["movement"],
        "pip": ["xarray", "h5netcdf", "h5py", "numpy", "pandas", "attrs", "loguru", "scipy"],
    },
    "sleap_io": {
        "alone": ["sleap-io"],
        "pip": [
            "numpy",
            "h5py",
            "attrs",
            "lazy-loader",
            "simplejson",
            "imageio",
            "pandas",
            "tqdm",
            "shapely",
            "click",
            "h5netcdf",
            "PyYAML",
            "scipy",
        ],
    },
    "ndx_pose": {"pip": ["pynwb", "ndx-pose", "numpy", "h5netcdf", "c3d", "PyYAML", "scipy"]},
}


def main(scratch: Path, names: list[str]) -> int:
    """Run the consumers; return 1 where one does not read what it should."""
    files = scratch / "files"
    write_files(files)
    rows = [run(scratch, name) for name in names or CONSUMERS]
    width = max(len(row[0]) for row in rows)
    print("\n".join(f"{name.ljust(width)}  {said}" for name, said, _ in rows))
    return int(any(failed for _, _, failed in rows))


def run(scratch: Path, name: str) -> tuple[str, str, bool]:
    """(consumer, what it says or why it could not be asked, whether that is a failure)."""
    python = environment(scratch / f"env-{name}", CONSUMERS[name])
    if python is None:
        return name, "could not be installed", True
    done = subprocess.run(
        [python, HERE / "checks" / f"check_{name}.py", scratch / "files"],
        capture_output=True,
        text=True,
        check=False,
    )
    lines = (done.stdout.strip() if done.returncode == 0 else done.stderr.strip()).splitlines() or [
        "nothing"
    ]
    return (
        name,
        "; ".join(lines) if done.returncode == 0 else f"FAILED: {lines[-1]}",
        done.returncode != 0,
    )


def environment(path: Path, needs: dict[str, list[str]]) -> Path | None:
    """Return the interpreter of an environment with what a consumer needs.

    None where pip cannot make it.
    """
    python = path / "bin" / "python"
    if (path / "done").exists():
        return python
    base = shutil.which(f"python{needs['python'][0]}") if "python" in needs else sys.executable
    if (
        base is None or subprocess.run([base, "-c", ""], check=False).returncode
    ):  # pyenv has names of what is not there
        return None
    subprocess.run([base, "-m", "venv", "--clear", path], check=True)
    pip = [python, "-m", "pip", "install", "--disable-pip-version-check", "-q"]
    safe = (
        ["-c", CONSTRAINTS]
        if "python" not in needs and not any("opencv" in each for each in needs["pip"])
        else ["-c", _torch_only(path)]
    )
    for command in (
        [*pip, *safe, *needs["pip"]],
        [*pip, "--no-deps", *needs["alone"]] if "alone" in needs else None,
    ):
        if command and subprocess.run(command, check=False, stderr=subprocess.DEVNULL).returncode:
            return None
    (path / "done").touch()
    return python


def _torch_only(path: Path) -> Path:
    """Constraints that hold torch alone, for consumers that want other versions of the rest."""
    file = path / "constraints.txt"
    file.write_text(
        "".join(
            line
            for line in CONSTRAINTS.read_text().splitlines(keepends=True)
            if line.startswith("torch=")
        )
    )
    return file


def write_files(files: Path) -> None:
    """Write a rig and poses in every format, SLEAP's detections, and what must come out of them."""
    rig, poses = make_rig(), make_poses()
    fish = replace(
        rig,
        cameras=tuple(
            replace(camera, distortion=camera.distortion[:4] / 10, fisheye=True)
            for camera in rig.cameras
        ),
    )
    for each in CAMERA_FORMATS:
        if each.write is not None and each.name != "4d-association":
            ending = (
                ""
                if each.folder
                else ".toml"
                if each.name in ("anipose", "pose2sim", "caliscope", "freemocap")
                else ".json"
            )
            write_cameras(files / f"{each.name}{ending}", rig, each.name)
    for name, ending in (
        ("anipose", ".toml"),
        ("colmap", ""),
        ("colmap-binary", ""),
        ("opencv", ""),
        ("caliscope", ".toml"),
    ):
        write_cameras(files / f"{name}-fisheye{ending}", fish, name)
    for form in POSE_FORMATS:
        if form.name != "nwb-3d":
            write_poses(
                files / f"poses-{form.name}{form.endings[0] if form.endings else '.h5'}",
                poses,
                form.name,
            )
    views = make_views()
    write_keypoints(files / "sleap", views, "sleap")
    points = np.random.default_rng(1).uniform(-0.5, 0.5, size=(20, 3))
    expected = {
        "points": points.tolist(),
        "names": list(rig.names),
        "rate": poses.rate,
        "keypoints": list(poses.poses.keypoints),
        "unit": "m",
    }
    expected |= {
        "individuals": list(poses.individuals),
        "frames": poses.poses.frames.tolist(),
        "positions": np.nan_to_num(poses.poses.positions, nan=-99.0).tolist(),
    }
    for key, each_rig in (("pixels", rig), ("pixels_fisheye", fish)):
        seen = [
            pixels_from_points(
                c, points @ each_rig.rotation[v].T + each_rig.translation[v]
            ).tolist()
            for v, c in enumerate(each_rig.cameras)
        ]
        expected[key] = seen
    expected["detections"] = {
        view.camera: np.nan_to_num(view.positions, nan=-99.0).tolist() for view in views
    }
    (files / "expected.json").write_text(json.dumps(expected))


def make_rig() -> CameraRig:
    """Three cameras about the middle of a room, metres."""
    lens = np.array([-0.12, 0.03, 1e-3, -2e-3, 1e-3])
    matrix = np.array([[1000.0, 0, 642.5], [0, 1000.5, 355.25], [0, 0, 1]])
    cameras = tuple(
        Camera(name, (1280, 720), matrix, lens, False) for name in ("cam1", "cam2", "cam10")
    )
    turns = matrix_from_vector(np.array([[0.1, angle, 0.05] for angle in (0.0, 1.5, 3.0)]))
    return CameraRig(cameras, turns, np.tile([0.1, -0.2, 4.0], (3, 1)), "m")


def make_poses() -> PoseFile:
    """Two individuals, three keypoints, frames 5 to 24, some points missing, metres, 60 Hz."""
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(20, 2, 3, 3))
    positions[3, 0, 1] = np.nan
    positions[7, 1] = np.nan
    quality = np.where(np.isfinite(positions[..., 0]), 0.75, np.nan)
    poses = Poses3D(
        ("nose", "ear", "tail"),
        np.arange(5, 25),
        positions,
        quality,
        np.where(np.isfinite(quality), 3, 0),
        quality,
        "m",
    )
    return PoseFile(poses, 60.0)


def make_views() -> tuple[Keypoints2D, ...]:
    """Two cameras with two instances, followed in the one and in any order in the other."""
    rng = np.random.default_rng(2)
    positions = rng.uniform(10, 600, size=(20, 2, 3, 2))
    positions[3, 0, 1] = np.nan
    positions[7, 1] = np.nan
    return tuple(
        Keypoints2D(
            camera=camera,
            keypoints=("nose", "ear", "tail"),
            frames=np.arange(20),
            positions=positions,
            confidence=np.where(np.isfinite(positions[..., 0]), 0.75, 0.0),
            tracked=camera == "tracked",
            image_size=(1280, 720),
            source="made",
        )
        for camera in ("tracked", "untracked")
    )


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).absolute(), sys.argv[2:]))
