"""The pages and the README: links, commands and Python work, and what is stated holds."""

import ast
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlsplit

import click
import numpy as np
import pytest
from conftest import load_script

import mocap_calib as mc
from mocap_calib.config import VERDICT_LIMITS_DEG
from mocap_calib.report import SCHEMA
from mocap_calib.results import FAULT_WORDS, VERDICTS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
SITE = tomllib.loads((ROOT / "zensical.toml").read_text("utf-8"))["project"]
WRITTEN = [*PAGES, *(ROOT / name for name in ("README.md", "CONTRIBUTING.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)


def text(page: Path) -> str:
    """Return the text of a page."""
    return page.read_text("utf-8")


def blocks(page: Path, *languages: str) -> list[str]:
    """Return the blocks of a page in some languages."""
    return [block for kind, block in BLOCK.findall(text(page)) if kind in languages]


def listed(entries: list[dict]) -> Iterator[str]:
    """Yield the pages of a navigation."""
    for entry in entries:
        for target in entry.values():
            yield from listed(target) if isinstance(target, list) else [target]


GROUP = load_script(DOCS / "make_cli.py").group


def test_every_page_is_in_the_navigation():
    assert sorted(listed(SITE["nav"])) == [page.name for page in PAGES]


# --- commands


def commands(page: Path) -> Iterator[list[str]]:
    """Yield the words of each call of the program in the blocks of a page."""
    for block in blocks(page, "sh", "text", "console", "bat"):
        for line in block.replace("\\\n", " ").splitlines():
            if not re.search(r"(^|[|(&] *)(\S*/)?mocap-calib ", line.strip()):
                continue
            tokens = shlex.shlex(line, posix=True, punctuation_chars="|&<>()")
            tokens.whitespace_split = True
            words = list(tokens)
            first = next(k for k, word in enumerate(words) if word.endswith("mocap-calib"))
            end = next(
                (k for k in range(first, len(words)) if set(words[k]) <= set("|&<>()")), len(words)
            )
            yield words[first + 1 : end]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_commands_that_pages_show_exist(page):
    """With all their options; what these are set to is not looked at."""
    for name, *words in commands(page):
        if name.startswith("-"):
            continue
        command = GROUP.get_command(click.Context(GROUP), name)
        assert command is not None, name
        context = click.Context(command)
        command.make_parser(context).parse_args(words)  # raises NoSuchOption


@pytest.mark.slow
def test_the_first_calibration(small, tool, tmp_path):
    """Each command of docs/first.md works, and the file that it hands on can be read.

    The example of docs/pipelines.md for Python reads what it wrote. The recording is a smaller one
    than that of examples/three_people, which `make demo` calibrates.
    """
    folder = shutil.copytree(small, tmp_path / "three_people")
    shown = [words for words in commands(DOCS / "first.md") if "--image-size" not in words]
    assert len(shown) == 7
    for words in shown:
        done = tool(*words, cwd=folder)
        assert done.returncode == 0, done.stderr
    assert (folder / "Calib.toml").is_file()
    assert (folder / "people_0.trc").is_file()
    (code,) = [code for code in blocks(DOCS / "pipelines.md", "python") if "h5py" in code]
    read = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True
    )
    assert read.stdout.startswith("m ")


# --- the first thing a newcomer sees


@pytest.mark.slow
@pytest.mark.skipif(
    not (ROOT / ".venv" / "installed").exists() or not shutil.which("make"),
    reason="not the environment that make makes",
)
def test_demo():
    said = subprocess.run(["make", "demo"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    median, largest = (
        float(re.search(rf"^{name} +(\S+)", said.stdout, re.M).group(1))
        for name in ("median", "max")
    )
    assert median < 0.1  # measured 0.02 degrees
    assert largest < 0.2  # 0.04
    assert "3 individuals in 200 of 200 frames" in said.stderr
    assert "the results are in out/demo" in said.stdout
    listed = said.stdout.split("the results are in out/demo")[1]
    for name in ("cameras.yaml", "poses3d.h5", "matches.csv", "run.json", "report.html"):
        assert name in listed


# --- Python in pages


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A folder to work in, with the files that the pages name; two people who are followed."""
    config = mc.SimulateConfig(cameras=3, people=2, frames=30, false_detections=0)
    made = mc.simulate(config)
    mc.write(made.files, tmp_path / "keypoints", format="coco")
    mc.write(made.rig, tmp_path / "reference.toml")
    mc.write(made.rig, tmp_path / "intrinsics.toml")
    for view in mc.simulate(replace(config, shuffle=False)).files:
        path = tmp_path / "videos" / f"{view.camera}DLC_resnet50.csv"
        mc.write(replace(view, tracked=True), path, format="deeplabcut-csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_readme(folder):
    """Measured: what is projected comes back within 1e-11 of a body."""
    (block,) = blocks(ROOT / "README.md", "python")
    assert len(re.findall(r"^(?:import|from) ", block, flags=re.MULTILINE)) == 1
    names = {}
    exec(block, names)
    poses, points = names["poses"], names["points"]
    assert names["pixels"].shape == (3, *poses.positions.shape[:-1], 2)
    np.testing.assert_allclose(points, poses.positions, rtol=0, atol=1e-9)
    rig = mc.read_rig(folder / "calibration.toml")
    np.testing.assert_allclose(rig.rotation, names["rig"].rotation, atol=1e-12)
    assert (folder / "out" / "run.json").is_file()


@pytest.mark.slow
def test_page(folder, capsys):
    """Every block works, after those before it; the rig is the true one (measured 0.1 degrees)."""
    pytest.importorskip("xarray")
    names = {}
    for block in blocks(DOCS / "python.md", "python"):
        exec(block, names)
    assert names["group"].verdict in capsys.readouterr().out
    assert np.degrees(names["evaluation"].rotation_error).max() < 0.5
    np.testing.assert_allclose(names["corner_point"], [0, 0, 6], atol=1e-9)
    centres = names["metric_rig"].centres
    assert np.linalg.norm(centres[0] - centres[1]) == pytest.approx(6.12)
    # the same rig and the same detections; the file has the rig with all digits
    assert names["matches"] == names["group"].matches
    staged = names["staged_rig"]  # in the world of the first camera
    assert np.degrees(mc.evaluate(staged, names["rig"]).rotation_error).max() < 0.05
    assert names["filtered"].positions.shape == names["staged_poses"].positions.shape
    written = {path.name for path in folder.iterdir()}
    assert {"Calib.toml", "model", "poses_0.trc", "poses_1.trc", "poses.nc", "openpose"} <= written


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_the_world():
    """The distance that the page states is that of the rig."""
    (block,) = blocks(ROOT / "docs/world.md", "python")
    names = {}
    exec(block, names)
    rig = names["result"].groups[0].rig
    assert rig.unit == "m"
    distance = np.linalg.norm(rig["cam1"].centre - rig["cam2"].centre)
    assert distance == pytest.approx(3.1, abs=1e-9)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_python_of_all_pages_can_be_read(page):
    for block in blocks(page, "python"):
        compile(textwrap.dedent(block), page.name, "exec")


def test_the_page_says_all_names():
    """Each name of `__all__` is on the page that shows the library."""
    page = text(DOCS / "python.md")
    assert [name for name in mc.__all__ if f"`{name}`" not in page] == []


# --- statements


README = text(ROOT / "README.md")


def test_the_table_shows_all_recordings_and_their_verdicts():
    script = load_script(ROOT / "benchmarks" / "recordings.py")
    header = "| " + " | ".join(script.HEADER) + " |\n"
    assert script.HEADER[1] == "verdict"
    assert header in README
    table = README.split(header)[1].split("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[1:]]
    assert [row[0] for row in rows] == list(script.NAMES)
    for row in rows:
        assert re.match(r"well determined|usable|weak|not determined|refused", row[1])
        assert len(row) == len(script.HEADER)


def constants() -> str:
    """Return all strings of the program, a line each, with what is put in left out."""
    found = []
    for folder in ("mocap_calib", "cli"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    parts = [p.value if isinstance(p, ast.Constant) else "{}" for p in node.values]
                    found.append("".join(parts))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.append(node.value)
    return "\n".join(found)


def test_messages_that_are_explained_exist():
    """Refusals keep what follows `expected` as an argument of its own."""
    rows = re.findall(r"^\| `([^`]+)` \|", text(DOCS / "messages.md"), re.MULTILINE)
    assert len(rows) > 20
    said = constants()
    assert [row for row in rows if row.removeprefix("expected ") not in said] == []


def rooms() -> list[str]:
    """Return the rows of the import contract, the highest first, as the table has them."""
    contracts = tomllib.loads(text(ROOT / "pyproject.toml"))["tool"]["importlinter"]["contracts"]
    (contract,) = (each for each in contracts if each["type"] == "layers")
    return [", ".join(f"`{room}`" for room in row.split(" | ")) for row in contract["layers"]]


def keypoint_formats() -> int:
    """Return how many formats of keypoints the page lists, which a test of `convert` holds."""
    table = text(DOCS / "formats.md").split("## Keypoint files")[1].split("### ")[0]
    return len(re.findall(r"^\| `(?!--)", table, re.MULTILINE))


LIMITS = [f"{limit:g}" for limit in VERDICT_LIMITS_DEG]
# page, pattern of what it states, what holds
CLAIMS = {
    "verdicts": (
        "docs/how-good.md",
        r"\n\| (\w[\w ]+) \| .*\d+ deg(?: and more)? \|",
        lambda: [*VERDICTS],
    ),
    "limits": ("docs/how-good.md", r"\| below (\d+) deg", lambda: LIMITS),
    "limits, README": ("README.md", r"\| below (\d+) deg", lambda: LIMITS),
    "limits, report": ("web/src/explain.ts", r"below (\d+)°", lambda: LIMITS),
    "schema": ("docs/run-json.md", r"version of this file: (\d+)", lambda: [str(SCHEMA)]),
    "faults": ("docs/run-json.md", r"\n\| `(\w+)` \| [^|\n]+ \|(?=\n)", lambda: [*FAULT_WORDS]),
    "formats": ("CHANGELOG.md", r"Keypoints in (\d+) formats", lambda: [str(keypoint_formats())]),
    "rooms": ("CONTRIBUTING.md", r"\n\| (`[^/].*?`) \| ", rooms),
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_what_pages_state_holds(claim):
    page, pattern, holds = CLAIMS[claim]
    assert re.findall(pattern, text(ROOT / page)) == holds()


def test_the_page_of_the_command_line_is_current():
    """`make cli-docs` makes it."""
    assert load_script(DOCS / "make_cli.py").make_page() == text(DOCS / "cli.md")


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.stem)
def test_files_that_pages_name_exist(page):
    named = re.findall(r"`((?:mocap_calib|cli|tests|benchmarks|docs|web)/[\w./-]+)[`:]", text(page))
    assert [name for name in named if "NAME" not in name and not (ROOT / name).exists()] == []


# --- the site


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The built site; warnings are errors."""
    pytest.importorskip("zensical", reason="the site is built with zensical (the extra docs)")
    folder = tmp_path_factory.mktemp("site")
    for name in ("docs", "zensical.toml"):
        (folder / name).symlink_to(ROOT / name)
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"


def test_links_of_the_site_lead_somewhere(site):
    """Within the site, places in pages included."""
    pages = {path.name: text(path) for path in site.glob("*.html")}
    places = {name: set(re.findall(r'\bid="([^"]+)"', page)) for name, page in pages.items()}
    lost = []
    for name, page in pages.items():
        for target in map(unescape, re.findall(r'(?:href|src)="([^"]+)"', page)):
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            file, place = unquote(parts.path).lstrip("/") or name, unquote(parts.fragment)
            known = not place or file not in pages or place in places[file]
            if not (site / file).exists() or not known:
                lost.append((name, target))
    assert lost == []


def test_pages_ask_no_other_server_for_anything(site):
    for path in site.glob("*.html"):
        assert re.findall(r'<(?:script|img|link)[^>]*(?:src|href)="https?:', path.read_text()) == []
