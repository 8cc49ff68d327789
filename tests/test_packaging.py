"""What is published: the source distribution and the wheel, as others build and install them."""

import configparser
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest
import yaml
from conftest import load_script
from test_architecture import SOURCES, imported_by

from mocap_calib import __version__

ROOT = Path(__file__).parents[1]
NOT_SOURCES = (".git", ".venv", "*.egg-info", "build", "dist", "out", "__pycache__", ".*_cache")
BUILD = """
import sys
from setuptools import build_meta
print(getattr(build_meta, sys.argv[1])(sys.argv[2]))
"""
# the packages of this environment, but not its .pth files: an editable mocap-calib is not there
DEPENDENCIES = os.pathsep.join(path for path in sys.path if path.endswith("site-packages"))


def call(*command: object, cwd: Path, path: str = "") -> str:
    """Return the stdout of a command that must succeed.

    path: of modules.
    """
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build(what: str, source: Path, target: Path) -> Path:
    """Return the archive that setuptools builds, `what` is the hook of PEP 517."""
    said = call(sys.executable, "-P", "-c", BUILD, what, target, cwd=source)
    return target / said.splitlines()[-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory) -> Path:
    """The source distribution, built from a copy without what git ignores."""
    folder = tmp_path_factory.mktemp("sdist")
    shutil.copytree(ROOT, folder / "copy", ignore=shutil.ignore_patterns(*NOT_SOURCES))
    return build("build_sdist", folder / "copy", folder)


@pytest.fixture(scope="module")
def unpacked(sdist) -> Path:
    """The folder in the source distribution."""
    with tarfile.open(sdist) as archive:
        archive.extractall(sdist.parent, filter="data")
    return sdist.with_name(sdist.name.removesuffix(".tar.gz"))


@pytest.fixture(scope="module")
def wheel(unpacked, tmp_path_factory) -> Path:
    """The wheel, built from the source distribution."""
    return build("build_wheel", unpacked, tmp_path_factory.mktemp("wheel"))


@pytest.mark.slow
def test_the_wheel_has_every_file_of_the_packages(wheel):
    packages = {"mocap_calib": ROOT, "mocap_calib_cli": ROOT / "cli"}
    expected = {
        f"{name}/{file}" for name, parent in packages.items() for file in list_files(parent / name)
    }
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert found == expected
    assert {"mocap_calib/py.typed", "mocap_calib/weights/people.safetensors"} <= found


@pytest.mark.slow
def test_an_index_takes_them(sdist, wheel):
    """Strictly: no warning either; and every link of the description is a whole address."""
    twine = (sys.executable, "-m", "twine", "--no-color")
    said = call(*twine, "check", "--strict", sdist, wheel, cwd=sdist.parent, path=DEPENDENCIES)
    assert said.count("PASSED") == 2
    with zipfile.ZipFile(wheel) as archive:
        name = f"mocap_calib-{__version__}.dist-info/METADATA"
        description = archive.read(name).decode("utf-8")
    links = re.findall(r"\]\(([^)]*)\)", description)
    assert len(links) >= 10
    assert all(re.match(r"https://|#", link) for link in links), links


@pytest.mark.slow
def test_the_wheel_works_by_itself(wheel, tmp_path):
    """In an empty environment, called from another folder; a kernel is compiled there."""
    venv.create(tmp_path / "empty", with_pip=False)
    programs = tmp_path / "empty" / ("Scripts" if os.name == "nt" else "bin")
    pip = (sys.executable, "-m", "pip", "--python", programs / "python", "install", "--quiet")
    call(*pip, "--no-deps", "--no-index", wheel, cwd=tmp_path)
    tool = programs / "mocap-calib"

    def run(*command: object) -> str:
        return call(*command, cwd=tmp_path / "elsewhere", path=DEPENDENCIES)

    (tmp_path / "elsewhere").mkdir()
    where = "import mocap_calib; print(mocap_calib.__file__)"
    package = Path(run(programs / "python", "-P", "-c", where).strip()).parent
    assert package.is_relative_to(tmp_path / "empty")
    take_compiled_kernels(package)
    lifter = list(package.glob("kernels/__pycache__/lifter.*.nbi"))
    for index in lifter:
        index.unlink()
    assert run(tool, "--version") == f"mocap-calib {__version__}\n"
    assert "rodent" in run(tool, "models")
    run(tool, "simulate", "--cameras", 2, "--people", 1, "--frames", 20, "-o", ".", "-q")
    run(tool, "run", "keypoints", "--cameras", "intrinsics.toml", "-o", "out", "-q")
    assert lifter
    assert all(index.is_file() for index in lifter)
    report = json.loads((tmp_path / "elsewhere" / "out" / "run.json").read_text("utf-8"))
    assert len(report["cameras"]) == 2


@pytest.mark.slow
def test_the_source_distribution_runs_its_own_tests(unpacked):
    """All that tests look at is there, and some are run."""
    for folder in (".ci", "benchmarks", "cli", "docs", "examples", "mocap_calib", "tests"):
        assert list_files(unpacked / folder) == list_files(ROOT / folder)
    for name in ("CHANGELOG.md", "CITATION.cff", "Makefile", "README.md", "constraints.txt"):
        assert (unpacked / name).read_bytes() == (ROOT / name).read_bytes()
    take_compiled_kernels(unpacked / "mocap_calib")
    pytest_alone = (sys.executable, "-P", "-m", "pytest", "-p", "no:cacheprovider")
    said = call(*pytest_alone, "tests/io/test_keypoint_details.py", cwd=unpacked)
    assert re.search(r"^[1-9][0-9]* passed", said, re.MULTILINE), said


def take_compiled_kernels(package: Path) -> None:
    """Take the machine code of this checkout along: `make` has compiled all of it."""
    ours, kernels = ROOT / "mocap_calib" / "kernels", package / "kernels"
    shutil.copytree(ours / "__pycache__", kernels / "__pycache__", dirs_exist_ok=True)
    for file in ours.glob("*.py"):
        shutil.copystat(file, kernels / file.name)  # numba compares sizes and times


def list_files(folder: Path) -> set[str]:
    """The files below a folder, but for what Python leaves behind."""
    files = {each.relative_to(folder).as_posix() for each in folder.rglob("*") if each.is_file()}
    return {file for file in files if "__pycache__" not in file}


# names of modules that are not those of the distributions that bring them
DISTRIBUTIONS = {"cv2": "opencv-python-headless", "dask": "distributed", "rerun": "rerun-sdk"}
DISTRIBUTIONS |= {"yaml": "pyyaml"}
BLENDER = {"bpy", "bmesh", "mathutils"}  # of the script that runs there


def test_what_is_imported_is_required():
    """Always or by an extra; other tests run where all packages are, and miss no line."""
    names = {name.partition(".")[0] for path in SOURCES for name in imported_by(path)}
    foreign = names - sys.stdlib_module_names - {"mocap_calib", "mocap_calib_cli"} - BLENDER
    needed = {DISTRIBUTIONS.get(name, name).replace("-", "_") for name in foreign}
    options = configparser.ConfigParser()
    options.read(ROOT / "setup.cfg", "utf-8")
    extras = {**options["options.extras_require"]}
    del extras["test"]
    required = "\n".join([options["options"]["install_requires"], *extras.values()]).lower()
    found = re.findall("^[a-z0-9-]+", required.replace("_", "-"), re.MULTILINE)
    assert needed - {name.replace("-", "_") for name in found} == set()
    assert {"torch", "pyyaml", "pynwb"} <= needed


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == __version__
    assert citation["license"] == "BSD-3-Clause"
    assert citation["authors"] == [{"name": "mocap-calib developers"}]


# --- the check before make installs


CHECK = ROOT / ".ci" / "check_torch.py"


def report(version: str, *required: str) -> dict:
    """What pip says that it would install."""
    metadata = {"name": "torch", "version": version, "requires_dist": ["filelock", *required]}
    return {"install": [{"metadata": metadata}]}


def test_cuda_is_found_where_it_would_be_installed():
    """As torch 2.13 requires it on Linux, and names it elsewhere."""
    here = f'platform_system == "{platform.system()}"'
    check = load_script(CHECK)
    found = check.find_cuda_packages(
        report(
            "2.13.0",
            f"cuda-toolkit[cublas,cudart]==13.0.3; {here}",
            f'nvidia-cudnn-cu13==9.20.0.48; {here} and python_version >= "3.11"',
            'nvidia-nccl-cu13==2.29.7; platform_system == "Elsewhere"',
            'optree>=0.13.0; extra == "optree"',
        )
    )
    assert found == ["cuda-toolkit", "nvidia-cudnn-cu13"]
    for answer in (report("2.13.0+cpu"), {"install": []}):
        assert check.find_cuda_packages(answer) == []


def test_make_ends_in_a_line_before_it_downloads_cuda(monkeypatch):
    check = load_script(CHECK)
    answer = json.dumps(report("2.13.0", "nvidia-nccl-cu13==2.29.7")).encode()
    done = subprocess.CompletedProcess((), 0, stdout=answer)
    monkeypatch.setattr(check.importlib.util, "find_spec", lambda _: None)
    monkeypatch.setattr(check.subprocess, "run", lambda *_, **__: done)
    with pytest.raises(SystemExit) as ended:
        check.main()
    assert str(ended.value) == (
        "expected the CPU build of torch, found 2.13.0 with CUDA (5 GB: nvidia-nccl-cu13); "
        "install torch into .venv first, as README.md says under Installation, and call make again"
    )


def test_make_checks_torch_before_it_installs():
    recipe = (ROOT / "Makefile").read_text("utf-8").partition(".venv/installed: ")[2]
    assert recipe.index(".ci/check_torch.py") < recipe.index("$(INSTALL) -e .")
    section = (ROOT / "README.md").read_text("utf-8").partition("\n## Installation\n")[2]
    version = re.search("^torch==.*", (ROOT / "constraints.txt").read_text("utf-8"), re.MULTILINE)
    assert f"pip install {version[0]} --index-url" in section
