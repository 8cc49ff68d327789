"""What a newcomer types first: a word too few, a word misspelled."""

import re
import shlex

import click
import pytest
from click.testing import CliRunner

from mocap_calib.io.cameras.formats import CAMERA_FORMATS
from mocap_calib_cli.main import COMMANDS, group


def complaint(line: str) -> str:
    """Return the line of a usage error, by a command that is called in this process."""
    done = CliRunner().invoke(group, shlex.split(line), prog_name="mocap-calib")
    assert done.exit_code == 2, done.output
    assert done.stdout == ""
    return done.stderr.splitlines()[-1]


def test_no_cameras_says_what_is_needed_where_to_get_it_and_what_is_read():
    for command in ("pairwise x", "complete x -o out"):  # run and batch do without
        said = complaint(command)
        assert said.startswith(
            "Error: Missing option '--cameras'. Expected a file with the intrinsics"
        )
        assert "focal length, principal point, lens distortion" in said
        assert "film a checkerboard" in said
        assert all(each.name in said for each in CAMERA_FORMATS)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("run", "Missing argument 'KEYPOINTS...'. Expected the folder with the 2D keypoints"),
        ("batch", "Missing argument 'RECORDINGS...'. Expected a folder for each recording"),
        ("match x", "Missing option '--rig'. Expected a file that says where the cameras stand"),
        ("adjust x --rig r", "Missing option '--matches'. Expected a file that says who is who"),
        ("evaluate", "Missing argument 'CAMERAS'. Expected a file that says where the cameras"),
        ("evaluate x", "Missing option '--reference'. Expected a calibration to compare with"),
        ("average", "Missing argument 'PAIRS'. Expected the file that `pairwise` wrote"),
        ("convert a", "Missing argument 'INPUT...'. Expected what to convert, then where to"),
        ("rnu", "found rnu; did you mean run?"),
        ("keypoints/", "expected one of the commands run, batch, inspect"),
        ("inspect x --image-size 1280", "expected a width and a height above 0, as 1280x720"),
        ("inspect x --frame-offset 3", "expected camera:frames with a whole number, as cam1:-3"),
        ("inspect x --crop-offset a:3", "expected camera:x,y, as cam1:640,0, found 3"),
        ("inspect x --camera-regex (", "expected a regular expression, as 'cam[0-9]+'"),
    ],
)
def test_wrong_usage_says_what_was_expected(line, said):
    assert said in complaint(line)


def test_what_completed_keypoints_cannot_be_written_as_is_said_first(tmp_path):
    """Neither of the files is there."""
    for target, said in (("trc", "keypoint formats"), ("sleap-slp", "only read")):
        words = ["complete", "k", "--cameras", "c", "-o", tmp_path / "out", "--to", target]
        done = CliRunner().invoke(group, [*map(str, words)])
        assert done.exit_code == 1
        assert said in done.stderr


# --- the examples of the help texts

# what is in examples/three_people, what a run leaves in `out`, and the examples for each other
THERE = {"keypoints/", "intrinsics.toml", "reference.toml", "out/cameras.yaml", "out/poses3d.h5"}
THERE |= {"out/calibration.toml", "out/matches.csv", "openpose/", "pairs.json"}
MINE = ("pairwise", "average", "match", "triangulate", "convert", "complete", "evaluate")


def examples(text: str) -> list[str]:
    return re.findall(r"^ *(mocap-calib .*)$", text, re.M)


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_are_valid(name, tmp_path, monkeypatch):
    """click takes each of them, and a file of options that one names."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recording.yaml").write_text("keypoints: k\noutput: o\n", encoding="utf-8")
    command = group.get_command(click.Context(group), name)
    for example in examples(command.get_help(click.Context(command))):
        for part in example.split(" | "):
            words = shlex.split(re.split(r" [<>]", part)[0])
            called = group.get_command(click.Context(group), words[1])
            called.make_context(words[1], words[2:])


@pytest.mark.parametrize("name", MINE)
def test_examples_work_in_the_folder_of_the_example(name):
    command = group.get_command(click.Context(group), name)
    said = command.get_help(click.Context(command))
    assert "Example, in the folder examples/three_people" in said
    for example in examples(said):
        for part in re.split(r"[|<]", example):
            words = shlex.split(part.partition(" >")[0])
            inputs = [
                word for word, before in zip(words[1:], words, strict=False) if before != "-o"
            ]
            if "convert" in words:
                inputs.remove(words[3])  # the output
            paths = {word for word in inputs if re.search(r"/$|\.\w", word)}
            assert paths <= THERE, example
