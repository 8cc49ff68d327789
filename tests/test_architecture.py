"""The rules of the house that a machine can hold."""

import ast
import os
import re
import subprocess
import sys
from configparser import ConfigParser
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TESTS = sorted((ROOT / "tests").rglob("*.py"))
SOURCES = sorted([*(ROOT / "mocap_calib").rglob("*.py"), *(ROOT / "cli").rglob("*.py")])
IN_ONE_PLACE = {"types.py", "results.py", "config.py"}  # all nouns, all constants
NOT_ON_WINDOWS = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}


def passes(name: str, *words: str) -> None:
    """Run a tool of this environment over the checkout, which must have nothing against it."""
    tool, path = Path(sys.executable).with_name(name), f"{ROOT}:{ROOT / 'cli'}"
    done = subprocess.run(
        [tool, *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_imports_go_one_way():
    passes("lint-imports")


def test_ruff():
    passes("ruff", "check", ".")
    passes("ruff", "format", "--check", ".")


@pytest.mark.slow
def test_mypy():
    passes("mypy")


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
def test_a_module_keeps_the_rules(path):
    """It is short and documented, like its functions; it can be imported on Windows.

    It opens text as UTF-8 with the same line ends everywhere: where nothing is said, Windows
    writes its own line ends, in the code page of the country.
    """
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    assert len(text.splitlines()) <= 420 or path.name in IN_ONE_PLACE
    assert ast.get_docstring(tree), "a module says what it is for"
    at_start = [node for node in tree.body if isinstance(node, ast.Import)]
    assert not NOT_ON_WINDOWS & {alias.name for node in at_start for alias in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            doc = ast.get_docstring(node, clean=False)
            lines = node.end_lineno - node.lineno - (len(doc.splitlines()) if doc else 0)
            assert lines <= 60, f"{node.name}: {lines} lines"
        if is_text(node):
            said = {keyword.arg for keyword in node.keywords}
            assert said >= {"encoding", "newline"}, f"{path}:{node.lineno}"


def is_text(node: ast.AST) -> bool:
    """Whether a node opens a file as text, or writes one."""
    if not isinstance(node, ast.Call):
        return False
    function = ast.unparse(node.func)
    if function == "open" or function.endswith(".open"):
        mode = [arg.value for arg in node.args if isinstance(arg, ast.Constant)]
        return not any("b" in str(letters) for letters in mode)
    return function.endswith(".write_text") and function != "outputs.write_text"


POSIX = re.compile(
    r"\bSIG(KILL|STOP|SEGV|XCPU)\b|os\.(fork|kill|mkfifo|getuid)\b|\bimport resource\b"
)


def test_what_needs_posix_says_so():
    """And is skipped elsewhere."""
    for path in TESTS:
        text = path.read_text("utf-8")
        if path.name.startswith("test_") and path != Path(__file__) and POSIX.search(text):
            assert "from platforms import" in text, path


def test_text_is_shown_by_one_function():
    """Which escapes control characters; `outputs` and `convert` write bytes."""
    calls = {path.name for path in (ROOT / "cli").rglob("*.py") if "click.echo" in path.read_text()}
    assert calls == {"screen.py", "outputs.py", "convert.py"}


def test_the_readme_says_what_each_dependency_is_for():
    setup = ConfigParser()
    setup.read(ROOT / "setup.cfg")
    needed = re.findall(r"^([\w-]+)", setup["options"]["install_requires"], re.M)
    readme = (ROOT / "README.md").read_text("utf-8")
    table = readme.split("## What each dependency is for")[1].split("##")[0]
    assert sorted(re.findall(r"^\| ([\w-]+) \|", table, re.M)[1:]) == sorted(needed)


DOORS = {  # module: where alone it is imported
    "torch": ("mocap_calib/training/", "mocap_calib/paper/"),
    "cv2": ("mocap_calib/geometry/epipolar.py", "mocap_calib/overlay/"),
    "pycolmap": ("mocap_calib/io/formats/colmap.py", "mocap_calib/paper/five_point.py"),
    "h5py": ("mocap_calib/io/",),
    "h5netcdf": ("mocap_calib/io/",),
    "c3d": ("mocap_calib/io/",),
    "pynwb": ("mocap_calib/io/",),
    "rerun": ("mocap_calib/io/formats/rerun_file.py",),
    "bpy": ("mocap_calib/io/formats/blender_scene.py",),  # which Blender runs
    # results and front name both to type checkers
    "xarray": ("mocap_calib/io/", "mocap_calib/results.py", "mocap_calib/front.py"),
    "plotly": (
        "mocap_calib/notebook/figure.py",
        "mocap_calib/results.py",
        "mocap_calib/front.py",
    ),
    "tomli_w": ("mocap_calib/io/",),
    "yaml": (
        *("mocap_calib/io/", "mocap_calib/recording/joints.py"),
        "cli/mocap_calib_cli/option_files.py",
    ),
    "distributed": ("mocap_calib/compute/cluster.py",),
    "dask": ("mocap_calib/compute/cluster.py",),
    "mocap_calib.compute.cluster": ("cli/",),
    "click": ("cli/",),
    "rich": ("cli/",),
    "mocap_calib_cli": ("cli/",),
}


def test_no_module_names_truth_and_reference():
    """They are for judging; `simulate` writes both, and `evaluate` has one in its examples."""
    for path in SOURCES:
        text = path.read_text("utf-8")
        assert "truth.npz" not in text or path.match("synthetic/scene_files.py"), path
        judges = path.match("synthetic/scene_files.py") or path.is_relative_to(ROOT / "cli")
        assert judges or "reference.toml" not in text, path


@pytest.mark.parametrize("module", DOORS)
def test_one_door_for(module):
    importers = {
        path.relative_to(ROOT).as_posix()
        for path in SOURCES
        for name in imported_by(path)
        if name == module or name.startswith(f"{module}.")
    }
    assert importers, "nothing imports it: the row is stale"
    assert all(path.startswith(DOORS[module]) for path in importers), importers


@cache
def imported_by(path: Path) -> frozenset[str]:
    """Return the modules that a file imports, late imports too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return frozenset(found)
