"""The same seed gives the same cameras elsewhere: with other sums of the linear algebra library,
and on the other versions of Python.

Deviations measured on seven real recordings, in units of the rig: 8e-8 at most between kernels of
OpenBLAS (Prescott, Nehalem, Haswell, SkylakeX); none between versions of Python.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mocap_calib as mc

ROOT = Path(__file__).parents[1]
SAME = 1e-6
COMMAND = """
import sys
import threadpoolctl
from mocap_calib_cli.main import group
group.main({arguments!r}, standalone_mode=False)
print(*(each.get("architecture") for each in threadpoolctl.threadpool_info()))
"""
NEEDED = "import c3d, click, cv2, h5netcdf, h5py, msgspec, numba, pycolmap, rich, scipy"
VERSIONS = ("3.11", "3.12", "3.13")
OTHERS = [each for each in VERSIONS if each != "{}.{}".format(*sys.version_info)]


def assert_same_elsewhere(done, small, out, *, python=sys.executable, **changed) -> str:
    """Run the recording in another process; return the kernels of its linear algebra."""
    cameras = str(small / "intrinsics.toml")
    words = ["run", str(small / "keypoints"), "--cameras", cameras, "-o", str(out), "-q"]
    program = COMMAND.format(arguments=[*words, "--no-report"])
    paths = os.pathsep.join([str(ROOT), str(ROOT / "cli")])
    environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", **changed}
    said = subprocess.run(
        [python, "-P", "-c", program], capture_output=True, text=True, env=environment, check=False
    )
    assert said.returncode == 0, said.stderr
    rig, other = (mc.read_rig(folder / "cameras.yaml") for folder in (done[0], out))
    assert rig.names == other.names
    for name in ("rotation", "translation"):
        np.testing.assert_allclose(getattr(other, name), getattr(rig, name), rtol=0, atol=SAME)
    for camera, same in zip(rig.cameras, other.cameras, strict=True):
        np.testing.assert_allclose(same.matrix, camera.matrix, rtol=SAME)
        np.testing.assert_allclose(same.distortion, camera.distortion, rtol=0, atol=SAME)
    return said.stdout


@pytest.mark.slow
def test_other_sums_give_the_same_rig(done, small, tmp_path):
    """Nehalem adds in another order than any processor with AVX."""
    out = tmp_path / "out"
    kernels = assert_same_elsewhere(done, small, out, OPENBLAS_CORETYPE="Nehalem").split()
    if sys.platform == "linux" and os.uname().machine == "x86_64":
        assert set(kernels) == {"Nehalem"}


@pytest.mark.slow
@pytest.mark.parametrize("version", OTHERS)
def test_other_versions_of_python_give_the_same_rig(done, small, tmp_path, version):
    """Where they are: `python3.12` on the path, or in MOCAP_CALIB_PYTHONS (with `:` between)."""
    assert_same_elsewhere(done, small, tmp_path / "out", python=find_python(version))


def find_python(version: str) -> str:
    """Return a Python of a version that has what the program needs, or skip and say why."""
    listed = os.environ.get("MOCAP_CALIB_PYTHONS", "").split(os.pathsep)
    check = f"import sys; assert sys.version.startswith('{version}.'); {NEEDED}"
    for python in filter(None, (*listed, shutil.which(f"python{version}"))):
        tried = subprocess.run([python, "-c", check], capture_output=True, text=True, check=False)
        if tried.returncode == 0:
            return python
    pytest.skip(f"no python{version} that has {NEEDED[7:]}; MOCAP_CALIB_PYTHONS names others")
