"""Call the methods of `peers.py` in an environment that has aniposelib 0.8.0."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.types import CameraRig, Floats

PEERS = Path(__file__).with_name("peers.py")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def describe_rig(rig: CameraRig) -> dict[str, Floats]:
    """Return the arrays of the cameras in a problem."""
    return {
        "matrix": np.stack([camera.matrix for camera in rig.cameras]),
        "distortion": np.stack([np.pad(camera.distortion, (0, 5))[:5] for camera in rig.cameras]),
        "size": np.array([camera.size for camera in rig.cameras]),
        "rotation": vector_from_matrix(rig.rotation),
        "translation": rig.translation,
    }


def call_peer(method: str, scratch: Path, problem: dict[str, Floats]) -> dict[str, Floats]:
    """Return what a method finds on one thread; its environment is made where it lacks."""
    python = scratch / "peers" / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", scratch / "peers"], check=True)
        install = [python, "-m", "pip", "install", "--quiet", "aniposelib==0.8.0"]
        subprocess.run(install, check=True, stdout=sys.stderr)
    np.savez(scratch / "problem.npz", **problem)
    command = [python, PEERS, method, scratch / "problem.npz", scratch / "result.npz"]
    subprocess.run(command, check=True, stdout=sys.stderr, env=os.environ | ONE_THREAD)
    with np.load(scratch / "result.npz") as result:
        return dict(result)
