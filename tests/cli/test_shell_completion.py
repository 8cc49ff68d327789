"""What the shell offers when TAB is pressed, by click's protocol."""

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete, get_completion_class
from conftest import TOOL

from mocap_calib.io.kinds import FORMATS
from mocap_calib.lift.lifter import shipped_tokens
from mocap_calib.recording.joints import SHIPPED
from mocap_calib_cli.main import COMMANDS, group

FILES = [("file", "")]
NUMBERS = (click.IntRange, click.FloatRange, click.types.BoolParamType)


def offered(line: str) -> list[tuple[str, str]]:
    """Return (type, value) of what is offered for the last word of a line."""
    *words, last = line.split(" ")
    complete = ShellComplete(group, {}, "mocap-calib", "_MOCAP_CALIB_COMPLETE")
    return [(item.type, item.value) for item in complete.get_completions(words, last)]


def values(line: str) -> set[str]:
    return {value for _, value in offered(line)}


def read(kind: str) -> set[str]:
    return {each.name for each in FORMATS[kind] if not each.only_written}


def written(kind: str) -> set[str]:
    return {each.name for each in FORMATS[kind] if each.write is not None}


def test_commands_and_options_are_offered():
    assert values("") == set(COMMANDS)
    assert values("ev") == {"evaluate"}
    assert values("run --c") == {
        *("--cameras", "--camera-regex", "--camera-distance", "--crop-offset", "--config")
    }


@pytest.mark.parametrize(
    "command", ["run", "batch", "inspect", "pairwise", "complete", "match", "verify"]
)
def test_formats_of_keypoints_and_layouts_are_offered_wherever_they_are_read(command):
    assert values(f"{command} x --format ") == read("keypoints")
    assert values(f"{command} x --format deep") == {"deeplabcut-h5", "deeplabcut-csv"}
    assert values(f"{command} x --layout body_25") == {"body_25", "body_25b"}


def test_formats_of_all_kinds_are_offered():
    everything = read("keypoints") | read("cameras") | read("poses")
    assert values("convert a b --from ") == everything
    assert values("convert a b --to ") == (
        written("keypoints") | written("cameras") | written("poses")
    )
    assert values("convert a b --to s") == {"sleap", "sleap-anipose"}
    assert values("complete x --to ") == written("keypoints")


@pytest.mark.parametrize("command", ["run", "batch"])
def test_what_a_run_writes_is_offered_without_formats_that_need_a_unit(command):
    offer = values(f"{command} x --write ")
    assert {"colmap", "anipose", "movement-3d", "npz"} <= offer
    assert not offer & {"trc", "c3d", "pose2sim", "dannce", "coco"}
    assert offer < written("cameras") | written("poses")


def test_models_skeletons_and_solvers_are_offered():
    assert values("run x --model ") == {*SHIPPED, *shipped_tokens(), "none", ""}
    assert "people_token" in shipped_tokens()
    assert offered("run x --model mine") == [("file", "mine")]
    assert values("train x --skeleton r") == {"rodent", "r"}
    assert values("pairwise x --solver ") == {"search", "paper", "five-point"}
    assert values("convert a b --unit ") == {"m", "cm", "mm"}
    assert values("simulate --kind ") == {"people", "quadruped", "rodent", "bird"}
    assert values("simulate --kind r") == {"rodent"}


@pytest.mark.parametrize(
    "line",
    [
        *(f"{name} " for name in ("run", "batch", "inspect", "pairwise", "average", "match")),
        *(
            f"{name} "
            for name in ("adjust", "triangulate", "convert", "complete", "evaluate", "verify")
        ),
        *("train ", "convert a ", "train --from ", "run --skeleton ", "run -o ", "match -o "),
        *(
            "run --config ",
            "run --save-config ",
            "run --cameras ",
            "batch --cameras ",
            "inspect --cameras ",
            "match --rig ",
        ),
        *("adjust --matches ", "adjust --matches-out ", "evaluate --reference "),
    ],
)
def test_paths_are_offered_where_paths_are_expected(line):
    assert offered(line) == FILES


def test_it_is_documented_for_each_shell():
    page = (Path(__file__).parents[2] / "docs" / "completion.md").read_text("utf-8")
    for shell in ("bash", "zsh", "fish"):
        assert f"_MOCAP_CALIB_COMPLETE={shell}_source mocap-calib" in page
        complete = get_completion_class(shell)(group, {}, "mocap-calib", "_MOCAP_CALIB_COMPLETE")
        assert f"_MOCAP_CALIB_COMPLETE={shell}_complete" in complete.source_template % (
            complete.source_vars()
        )


def test_every_option_that_takes_a_name_offers_something():
    """All options are looked at but numbers and flags; those that take free text are listed."""
    free = {"image-size", "camera-regex", "frame-offset", "crop-offset", "views", "scheduler"}
    free |= {
        "data",
        "terms",
        "up",
        "mirrored",
        "sides",
        "rotated",
        "resized",
        "exchanged",
        "moved",
        "fps",
        "world",
        "height",
        "length",
        "camera-distance",
        "forward",
        "video",
        "frames",
    }
    for name in COMMANDS:
        context = click.Context(group)
        command = group.get_command(context, name)
        for param in command.params:
            long = max(param.opts, key=len).removeprefix("--")
            if not isinstance(param.type, NUMBERS) and long not in free:
                assert param.shell_complete(context, ""), f"{name} --{long}"


def test_bash_gets_formats_without_torch():
    """Measured 0.5 s of a processor for the formats of all kinds."""
    asked = {"COMP_WORDS": "mocap-calib convert a b --to sl", "COMP_CWORD": "5"}
    done = subprocess.run(
        [sys.executable, "-X", "importtime", TOOL],
        env={**os.environ, **asked, "_MOCAP_CALIB_COMPLETE": "bash_complete"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["plain,sleap-anipose", "plain,sleap"]
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "mocap_calib.io.kinds" in imported
    assert not imported & {"torch", "cv2", "scipy", "rich"}
