"""The rules of the house that a machine can hold."""

import ast
import os
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted([*(ROOT / "mocap_calib").rglob("*.py"), *(ROOT / "cli").rglob("*.py")])


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_imports_go_one_way():
    tool = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [tool],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'cli'}"},
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff():
    for command in (["ruff", "check"], ["ruff", "format", "--check"]):
        done = run(*command, ".")
        assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_mypy():
    done = run("mypy")
    assert done.returncode == 0, done.stdout


def test_packages_are_listed():
    setup = ConfigParser()
    setup.read(ROOT / "setup.cfg")
    listed = set(setup["options"]["packages"].split())
    there = {
        ".".join(p.parent.relative_to(ROOT).parts).removeprefix("cli.")
        for p in SOURCES
        if p.name == "__init__.py"
    }
    assert listed == there


@pytest.mark.parametrize("path", SOURCES, ids=[str(p.relative_to(ROOT)) for p in SOURCES])
def test_files_are_short_and_documented(path):
    text = path.read_text("utf-8")
    assert len(text.splitlines()) <= 330
    assert ast.get_docstring(ast.parse(text)), "a module says what it is for"


@pytest.mark.parametrize("path", SOURCES, ids=[str(p.relative_to(ROOT)) for p in SOURCES])
def test_functions_fit_on_a_screen(path):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.FunctionDef):
            doc = ast.get_docstring(node, clean=False)
            lines = node.end_lineno - node.lineno - (len(doc.splitlines()) if doc else 0)
            assert lines <= 60, f"{node.name}: {lines} lines"


def test_one_door_for_each_heavy_dependency():
    doors = {
        "torch": ("steerpose", "cli"),
        "cv2": ("geometry",),
        "h5py": ("io",),
        "c3d": ("io",),
        "h5netcdf": ("io",),
        "pynwb": ("io",),
        "click": ("cli",),
        "rich": ("cli",),
        "distributed": ("mocap_calib/compute/cluster.py",),
        "dask": ("mocap_calib/compute/cluster.py",),
    }
    for path in SOURCES:
        inside = str(path.relative_to(ROOT))
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = (
                [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else []
            )
            for name in names:
                door = doors.get(name.split(".")[0])
                assert door is None or any(d in inside for d in door), f"{inside} imports {name}"
