"""What a newcomer types first: help, its examples, a word too few, a word misspelled."""

import os
import re
import shlex
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest
from conftest import TOOL
from platforms import posix

import mocap_calib as mc

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "three_people"
HEAVY = ("torch", "pycolmap", "scipy", "cv2", "h5py", "numpy", "rich", "yaml")
COMMANDS = re.findall(r"^## mocap-calib (\w+)$", (ROOT / "docs" / "cli.md").read_text(), re.M)


def imported(code: str) -> set[str]:
    """The modules that a program has imported in the end."""
    code += "\nimport sys; print(*sys.modules)"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=EXAMPLE)
    return set(done.stdout.splitlines()[-1].split())


def call(*words: str) -> str:
    """Python that calls the command, which ends well."""
    return f"""
import sys
from mocap_calib_cli.main import main
sys.argv = ["mocap-calib", *{words!r}]
try:
    main()
except SystemExit as end:
    assert not end.code, sys.argv
"""


@pytest.mark.parametrize("words", [("--help",), ("run", "--help")])
def test_help_leaves_the_heavy_things_alone(words):
    assert not imported(call(*words)) & {*HEAVY}


def test_what_needs_no_network_does_not_wait_for_torch():
    """It would take two seconds longer; measured 0.3 to 0.7 s of a processor without."""
    code = call("convert", "reference.toml", "-", "--to", "mocap-calib")
    code += call("inspect", "keypoints", "--cameras", "intrinsics.toml")
    code += call("evaluate", "reference.toml", "--reference", "reference.toml") + call("models")
    assert not imported(code) & {"torch", "scipy.optimize", "cv2", "rich"}


def examples(tool, name: str) -> list[str]:
    """The examples of a help text."""
    said = tool(name, "--help").stdout
    return re.findall(r"^ *(mocap-calib .*)$", said.split("Example", 1)[1], re.M)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_examples_that_are_no_wrong_usage(name, tool, tmp_path):
    """The files that they name are not there."""
    (tmp_path / "recording.yaml").write_text("keypoints: k\noutput: o\n", encoding="utf-8")
    found = examples(tool, name)
    assert found
    for example in found:
        if name in ("doctor", "example", "simulate", "models", "train") or "tcp://" in example:
            continue
        for part in example.split(" | "):
            done = tool(*shlex.split(re.split(r" [<>]", part)[0])[1:], cwd=tmp_path)
            assert done.returncode == 1, done.stderr
            assert "Usage:" not in done.stderr


def test_the_list_of_commands_is_that_of_the_page(tool):
    listed = re.findall(r"^  (\w+)  ", tool("--help").stdout.split("Commands:")[1], re.M)
    assert listed == COMMANDS
    assert re.fullmatch(r"mocap-calib \d+\.\d+\.\d+\n", tool("--version").stdout)


SIZE = "expected a width and a height above 0, as 1280x720, found"
PERCENT = "expected a share of up to 100%, as 5% or 0.05, found"
RATE = "expected frames per second above 0, or camera:frames per second, as cam1:25, found"
WHOLE = "expected a whole number of"
RUN = "run k --cameras i.toml -o o"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        # what is left out
        ("run", "Missing argument 'KEYPOINTS...'. Expected: folder with the 2D keypoints"),
        ("batch", "Missing argument 'RECORDINGS...'. Expected: folder for each recording"),
        ("match x", "Missing option '--rig'. Expected: file or folder with cameras and where"),
        ("adjust x --rig r", "Missing option '--matches'. Expected: file of the command `match`"),
        ("evaluate x", "Missing option '--reference'. Expected: calibration to compare with"),
        ("average", "Missing argument 'PAIRS'. Expected: file that `pairwise` wrote"),
        ("verify", "Missing argument 'CAMERAS'. Expected: calibration, then the keypoints"),
        # other words
        ("rnu", "found rnu; did you mean run?"),
        ("keypoints/", "expected one of the commands run, batch, inspect"),
        # forms
        ("inspect x --image-size 8x1.5", f"{SIZE} 8x1.5"),
        ("inspect x --image-size cam1:640", f"{SIZE} cam1:640"),
        ("inspect x --frame-offset a:1.5", "with a whole number, as cam1:-3, found a:1.5"),
        ("inspect x --frame-offset a:1e16", "with a whole number, as cam1:-3, found a:1e16"),
        ("inspect x --crop-offset a:3", "expected camera:x,y, as cam1:640,0, found a:3"),
        (
            f"{RUN} --resized a:0",
            "expected camera:factor above 0, or those of x and y, as cam1:0.5",
        ),
        (f"{RUN} --resized a:1,2,3", "as cam1:0.5 or cam1:1,0.75, found a:1,2,3"),
        (f"{RUN} --exchanged a,a", "expected two cameras, as cam1,cam2, found a,a"),
        (f"{RUN} --moved a", "expected camera:frame with a whole number, as cam1:500, found a"),
        (f"{RUN} --fps 30 --fps a:nan", f"{RATE} a:nan"),
        (f"{RUN} --fps a:30", "expected that of the other cameras too, as --fps 30, found a:30"),
        (f"{RUN} --height =1.7", "expected metres above 0, or individual=metres, as 0=1.75+-0.01"),
        (f"{RUN} --camera-distance a-b=-1", "expected two cameras and metres above 0, as cam1"),
        ("overlay o --video cam1 -o x", "expected CAM=FILE, found cam1"),
        ("overlay o --video a=1 --video a=2 -o x", "expected one video a camera, found two of a"),
        ("overlay o --video a=1 -o x --frames 1,", "expected frame numbers, as 100,200-210"),
        ("example cat", "expected one of people, dog, mouse, found cat"),
        ("simulate -o o --kind fish", "people, quadruped, rodent, bird, found fish"),
        ("simulate -o o --kind rodent:", "expected a number after the colon, as rodent:2, found"),
        ("simulate -o o --kind bird:0", f"{WHOLE} 1 or more, found 0"),
        ("simulate -o o --kind people:2 --people 3", "expected --people or --kind people, found"),
        # numbers
        ("batch a -o o --seed -1", f"{WHOLE} 0 or more, found -1"),
        ("batch a -o o --jobs 0", f"{WHOLE} 1 or more, found 0"),
        ("batch a -o o --jobs 2 --scheduler x", "--jobs is for this machine, --scheduler for"),
        ("convert a.h5 b.trc --fps nan", "expected a number above 0, found nan"),
        ("simulate -o o --frames 1e3", f"{WHOLE} 1 or more, found 1e3"),
        ("simulate -o o --noise inf", "expected a number of 0 or more, found inf"),
        ("simulate -o o --missing 5%", "expected a number from 0 to 1, found 5%"),
        ("simulate -o o --arc 400", "expected a number from 0 to 360, found 400"),
        ("train -o o --width 3", f"{WHOLE} 4 or more, found 3"),
        ("train -o o --width 6", "expected a multiple of 4"),
        (f"{RUN} --focal-uncertainty 0", f"{PERCENT} 0"),
        (f"{RUN} --focal-uncertainty 5", f"{PERCENT} 5"),
        # what does not go together
        ("run k -o o --refine none", "give --cameras"),
        ("batch k -o o --strict --accept not-determined", "--strict: expected it without --accept"),
        ("adjust k --rig r --matches m --strict --accept not-determined", "it without --accept"),
        (f"{RUN} --focal-per-camera", "--focal-per-camera: expected focal lengths that are"),
        (f"{RUN} --align m.csv --world cam1", "--align: expected the world of the landmarks alone"),
        (f"{RUN} --write kalibr", "--write: expected one of poses-h5, "),  # only read
        (f"{RUN} --write trc --fps 30", "convert OUT/poses3d.h5 NEW --to trc --fps FPS"),
        (f"{RUN} --write colmap --write pose2sim", "convert OUT/cameras.yaml NEW --to pose2sim"),
        ("scale out", "expected a known length, found none; say --height"),
        (f"adjust {EXAMPLE}/keypoints --rig - --matches - -q", "--rig and --matches cannot both"),
    ],
)
def test_wrong_usage_says_what_was_expected(line, said, tool, tmp_path):
    done = tool(*shlex.split(line), cwd=tmp_path, stdin=(EXAMPLE / "reference.toml").read_text())
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_no_cameras_says_what_is_needed_where_to_get_it_and_what_is_read(tool):
    for command in ("pairwise x", "complete x -o out"):  # run and batch do without
        said = tool(*command.split()).stderr.splitlines()[-1]
        assert "Missing option '--cameras'. Expected a file with the intrinsics" in said
        assert "focal length, principal point, lens distortion" in said
        assert "film a checkerboard" in said
        assert "Formats: mocap-calib, " in said
        assert " kalibr" in said


def test_every_option_has_a_help():
    """Made of its line in a docstring; a test of the pages holds this one to the commands."""
    options = re.findall(r"^- `-.*$", (ROOT / "docs" / "cli.md").read_text("utf-8"), re.M)
    assert len(options) > 80
    assert [line for line in options if not re.match(r"- `[^`]+`: \w", line)] == []
    few = mc.Config().view_graph.small_rig
    assert any(f"pairs of more than {few} cameras" in line for line in options)


# --- what the shell offers


def offered(tool, monkeypatch, line: str) -> list[str]:
    """What bash gets for the last word of a line, as `type,value`."""
    words = ["mocap-calib", *line.split(" ")]
    monkeypatch.setenv("COMP_WORDS", " ".join(words))
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    monkeypatch.setenv("_MOCAP_CALIB_COMPLETE", "bash_complete")
    said = tool()
    assert said.returncode == 0, said.stderr
    return said.stdout.split("\n")[:-1]


FILES = ["file,"]


@pytest.mark.parametrize(
    ("line", "some", "others"),
    [
        ("ev", "evaluate", None),
        ("run --ca", "--cameras --camera-regex --camera-distance", None),
        ("run x --format deep", "deeplabcut-h5 deeplabcut-csv", None),
        ("verify x --format coc", "coco coco-results", None),
        ("inspect x --layout body_25", "body_25 body_25b", None),
        ("convert a b --from tr", "trc", None),
        ("convert a b --to s", "sleap sleap-anipose", None),
        ("convert a b --to k", "", "kalibr"),
        ("kinematics x --from t", "trc", "sleap"),
        ("complete x --to co", "coco", "colmap"),
        ("verify x --to co", "colmap", "coco"),
        ("run x --write ", "colmap anipose movement-3d npz", "trc c3d pose2sim dannce coco"),
        ("batch x --write c", "colmap", "c3d coco"),
        ("pairwise x --solver ", "search paper five-point", None),
        ("convert a b --unit ", "m cm mm", None),
        ("simulate --kind ", "people quadruped rodent bird", None),
        ("simulate --kind r", "rodent", None),
        ("example d", "dog", None),
    ],
)
def test_names_are_offered(line, some, others, tool, monkeypatch):
    """others: what is not offered; None: all that is offered is named."""
    found = {each.removeprefix("plain,") for each in offered(tool, monkeypatch, line)}
    assert set(some.split()) <= found
    assert set(some.split()) == found if others is None else not found & set(others.split())


def test_models_and_skeletons_are_offered_beside_files(tool, monkeypatch):
    shipped = {f"plain,{name}" for name in ("people", "quadruped", "rodent", "bird")}
    models = offered(tool, monkeypatch, "run x --model ")
    assert {*shipped, "plain,people_token", "plain,none", *FILES} <= {*models}
    assert offered(tool, monkeypatch, "run x --model mine") == ["file,mine"]
    assert offered(tool, monkeypatch, "train x --skeleton r") == ["plain,rodent", "file,r"]
    assert len(offered(tool, monkeypatch, "")) == len(COMMANDS)


@pytest.mark.parametrize(
    "line",
    [
        *("run", "batch", "inspect", "pairwise", "average", "match", "adjust", "triangulate"),
        *("convert", "complete", "evaluate", "verify", "train", "convert a", "train --from"),
        *("run --skeleton", "run -o", "match -o", "run --config", "run --save-config"),
        *("run --cameras", "inspect --cameras", "match --rig", "adjust --matches"),
        *("adjust --matches-out", "evaluate --reference", "run --align", "overlay x --keypoints"),
    ],
)
def test_paths_are_offered_where_paths_are_expected(line, tool, monkeypatch):
    assert offered(tool, monkeypatch, f"{line} ") == FILES


# --- text on every system


def test_names_with_accents(small, tmp_path):
    """The files as macOS names them, the cameras as people type them, stdout in a code page."""
    names = {"cam1": "łódź1", "cam2": "façade", "cam3": "über"}
    cameras = (small / "intrinsics.toml").read_text("utf-8")
    for old, new in names.items():
        apart = unicodedata.normalize("NFD", new)
        assert apart != new
        (tmp_path / f"{apart}.json").write_bytes((small / "keypoints" / f"{old}.json").read_bytes())
        cameras = cameras.replace(f'"{old}"', f'"{new}"')
    (tmp_path / "intrinsics.toml").write_text(cameras, "utf-8", newline="\n")
    said = subprocess.run(
        [TOOL, "inspect", *sorted(tmp_path.glob("*.json")), "--cameras", "intrinsics.toml"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONIOENCODING": "cp1252"},
        capture_output=True,
        check=False,
    )
    assert (said.returncode, said.stderr.decode("utf-8")) == (0, "")
    text = said.stdout.decode("utf-8")
    assert all(name in text for name in names.values())
    assert "\r" not in text


@posix
@pytest.mark.parametrize("words", [("convert", "reference.toml", "-"), ("models",)])
def test_a_reader_that_goes_is_no_error_of_the_program(words):
    """Its status is 1, as the reader has not got all, and nothing is said."""
    read, write = os.pipe()
    os.close(read)
    command = [TOOL, *words, "--to", "mocap-calib"] if "convert" in words else [TOOL, *words]
    done = subprocess.run(command, cwd=EXAMPLE, stdout=write, stderr=subprocess.PIPE, check=False)
    os.close(write)
    assert (done.returncode, done.stderr.decode()) == (1, "")
