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

import mocap_calib as mc
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import Camera, CameraRig, Keypoints2D

HERE = Path(__file__).parent
CAMERAS = {  # format: ending of its file, "" = a folder
    **dict.fromkeys(("anipose", "pose2sim", "caliscope", "freemocap"), ".toml"),
    **dict.fromkeys(("panoptic", "voxelpose", "nerfstudio", "openmvg"), ".json"),
    **dict.fromkeys(("opencv", "easymocap", "jarvis", "colmap", "colmap-binary"), ""),
    **{"mocap-calib": ".yaml", "dannce": ".mat", "multiview-calib": ""},
}
FISHEYE = ("anipose", "colmap", "colmap-binary", "opencv", "caliscope")
POSES = {
    **{"poses-h5": ".h5", "npz": ".npz", "anipose-csv": ".csv", "trc": ".trc", "c3d": ".c3d"},
    **{"movement-3d": ".nc", "sleap-anipose": ".h5"},
}
RATE, INDIVIDUALS = 60.0, ("individual_0", "individual_1")
CONSTRAINTS = HERE.parents[1] / "constraints.txt"  # torch without CUDA, should anything ask for it
ANIPOSE = "numpy opencv-contrib-python-headless<5 toml numba scipy tqdm pandas jax"
POSE2SIM = "numpy opencv-python-headless rtoml scipy pandas matplotlib c3d anytree tqdm lxml"
CALISCOPE = "numpy opencv-python-headless rtoml scipy pandas pandera av platformdirs"
SLEAP = "numpy h5py attrs lazy-loader simplejson imageio pandas tqdm shapely click h5netcdf PyYAML"
# python: version, where the consumer needs another; alone: installed without its dependencies, most
# of which its readers do not use
CONSUMERS = {
    "opencv": {"pip": "opencv-python-headless numpy"},
    "aniposelib": {"alone": "aniposelib", "pip": ANIPOSE},
    "pycolmap": {"pip": "pycolmap numpy"},
    "pose2sim": {"alone": "pose2sim", "pip": f"{POSE2SIM} statsmodels filterpy"},
    "caliscope": {"alone": "caliscope", "pip": CALISCOPE},
    "c3d": {"pip": "c3d numpy"},
    "ezc3d": {"pip": "ezc3d numpy"},
    "opensim": {"pip": "opensim numpy"},
    "xarray": {"pip": "xarray h5netcdf h5py numpy"},
    "movement": {
        "python": "3.12",
        "alone": "movement",
        "pip": "xarray h5netcdf h5py numpy pandas attrs loguru scipy",
    },
    "sleap_io": {"alone": "sleap-io", "pip": f"{SLEAP} scipy threadpoolctl msgspec"},
    "ndx_pose": {"pip": "pynwb ndx-pose numpy h5netcdf c3d PyYAML scipy threadpoolctl msgspec"},
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
    """Return the consumer, what it prints, and whether it failed."""
    python = make_environment(scratch / f"env-{name}", CONSUMERS[name])
    if python is None:
        return name, "could not be installed", True
    command = [python, HERE / "checks" / f"check_{name}.py", scratch / "files"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return name, f"FAILED: {(done.stderr.strip().splitlines() or ['nothing'])[-1]}", True
    return name, "; ".join(done.stdout.strip().splitlines()), False


def make_environment(path: Path, needs: dict[str, str]) -> Path | None:
    """Return the interpreter of an environment with a consumer; None where pip cannot make it."""
    python = path / "bin" / "python"
    if (path / "done").exists():
        return python
    base = shutil.which(f"python{needs['python']}") if "python" in needs else sys.executable
    if base is None or subprocess.run([base, "-c", ""], check=False).returncode:
        return None  # pyenv has names of what is not there
    subprocess.run([base, "-m", "venv", "--clear", path], check=True)
    constraints = CONSTRAINTS
    if "python" in needs or "opencv" in needs["pip"]:  # other versions of all but torch
        lines = CONSTRAINTS.read_text("utf-8").splitlines(keepends=True)
        constraints = path / "constraints.txt"
        constraints.write_text("".join(line for line in lines if line.startswith("torch=")))
    pip = [python, "-m", "pip", "install", "--disable-pip-version-check", "-q"]
    commands = [[*pip, "-c", constraints, *needs["pip"].split()]]
    if "alone" in needs:
        commands.append([*pip, "--no-deps", needs["alone"]])
    for command in commands:
        if subprocess.run(command, check=False, stderr=subprocess.DEVNULL).returncode:
            return None
    (path / "done").touch()
    return python


def write_files(files: Path) -> None:
    """Write a rig and poses in every format, SLEAP's detections, and what must come out of them."""
    rig, poses, views = make_rig(), make_poses(), make_views()
    fish = replace(
        rig,
        cameras=tuple(
            replace(camera, distortion=camera.distortion[:4] / 10, fisheye=True)
            for camera in rig.cameras
        ),
    )
    files.mkdir(parents=True, exist_ok=True)
    for name, ending in CAMERAS.items():
        mc.write(rig, files / f"{name}{ending}", name)
        if name in FISHEYE:
            mc.write(fish, files / f"{name}-fisheye{ending}", name)
    for name, ending in POSES.items():
        path = files / f"poses-{name}{ending}"
        mc.write(poses, path, name, fps=RATE, individuals=INDIVIDUALS)
    mc.write(views, files / "sleap", "sleap")
    points = np.random.default_rng(1).uniform(-0.5, 0.5, size=(20, 3))
    expected = {
        "points": points.tolist(),
        "names": list(rig.names),
        "rate": RATE,
        "keypoints": list(poses.keypoints),
        "unit": "m",
        "individuals": list(INDIVIDUALS),
        "frames": poses.frames.tolist(),
        "positions": np.nan_to_num(poses.positions, nan=-99.0).tolist(),
        "pixels": rig.project(points).tolist(),
        "pixels_fisheye": fish.project(points).tolist(),
        "detections": {v.camera: np.nan_to_num(v.positions, nan=-99.0).tolist() for v in views},
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


def make_poses() -> mc.Poses3D:
    """Two individuals, three keypoints, frames 5 to 24, some points missing, metres."""
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(20, 2, 3, 3))
    positions[3, 0, 1] = np.nan
    positions[7, 1] = np.nan
    quality = np.where(np.isfinite(positions[..., 0]), 0.75, np.nan)
    return mc.Poses3D(
        ("nose", "ear", "tail"),
        np.arange(5, 25),
        positions,
        quality,
        np.where(np.isfinite(quality), 3, 0),
        quality,
        "m",
    )


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
