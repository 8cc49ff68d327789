"""`--config`, `--save-config`, and the recording.yaml of a recording in a batch."""

import json
import shutil
from pathlib import Path

import click
import pytest

from mocap_calib.errors import MismatchError, MocapCalibError
from mocap_calib.io.option_file import format_option, read_option_file
from mocap_calib_cli import option_files
from mocap_calib_cli.commands.run import command as run
from mocap_calib_cli.inputs import calibration_request
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.recordings import OF_RECORDINGS

ROOT = Path(__file__).parents[2]
OPTIONS = option_files.params_by_key(run)
ODD_TEXTS = (
    *("1:30", "on", "0x10", "007", "a: b", "a #b", "- x", "[x", "{x}", "'", '"', "*a", "&a", "!x"),
    *("null", "~", " ", "é ß 日本 😀", "a\nb", "\t", "%a", "@a", "x:", "? x", "---", "=", "<<"),
)


def parse(*words: object) -> click.Context:
    """What click makes of a command line."""
    return run.make_context("run", [str(word) for word in words])


def example_of(param: click.Parameter) -> str:
    """A value that is not the default."""
    if isinstance(param.type, click.Choice):
        return next(choice for choice in reversed(param.type.choices) if choice != param.default)
    if isinstance(param.type, click.types.BoolParamType):
        return "false" if param.default is True else "true"
    return {"integer": "3", "integer range": "3", "percentage": "0.07"}.get(param.type.name, "a.b")


def type_words(param: click.Parameter, value: str) -> list[str]:
    """The same on the command line."""
    if isinstance(param, click.Argument):
        return [value]
    names = param.secondary_opts if value == "false" else param.opts
    return [max(names, key=len), *([] if param.is_flag else [value])]


@pytest.mark.parametrize("key", OPTIONS)
def test_every_option_can_stand_in_a_file(key, tmp_path, monkeypatch):
    """And means there what it means on the command line; it comes back from --save-config."""
    monkeypatch.chdir(tmp_path)
    param = OPTIONS[key]
    value = example_of(param)
    needed = [word for each in ("keypoints", "output") if each != key for word in NEEDED[each]]
    typed = parse(*needed, *type_words(param, value))
    Path("one.yaml").write_text(f"{key}: {value}\n", "utf-8")
    read = parse(*needed, "--config", "one.yaml")
    assert read.params == typed.params
    assert read.params[param.name] != parse(*NEEDED["keypoints"], *NEEDED["output"]).params.get(
        param.name
    )
    text = option_files.format_options(typed, Path("saved.yaml"))
    Path("saved.yaml").write_text(text, "utf-8")
    assert parse("--config", "saved.yaml").params == typed.params
    assert f"\n{key}: " in text
    for other in OPTIONS.keys() - {key, "keypoints", "output"}:
        assert f"\n# {other}: " in text


NEEDED = {"keypoints": ["k"], "output": ["-o", "o"]}


@pytest.mark.parametrize("text", ODD_TEXTS)
def test_texts_are_what_stands_there(text, tmp_path):
    """Not what YAML makes of them: a sexagesimal number, a truth value, nothing."""
    path = tmp_path / "odd.yaml"
    path.write_text(format_option("views", [text]) + format_option("fps", [text, text]), "utf-8")
    found = read_option_file(path, {"views", "fps"})
    assert found["views"].texts == (text,)
    assert found["fps"].texts == (text, text)


def test_paths_are_those_beside_the_file(tmp_path, monkeypatch):
    """Words that are no paths stay as they are, and so does the standard input."""
    monkeypatch.chdir(tmp_path)
    folder = Path("sessions/one")
    folder.mkdir(parents=True)
    (folder / "mine").touch()
    (folder / "recording.yaml").write_text(
        "keypoints: [left=a.json, b.json]\ncameras: '-'\noutput: ../out\nalign: /x/marks.csv\n"
        "model: mine\nworld: cam1\nskeleton: joints.yaml\n",
        "utf-8",
    )
    found = parse("--config", folder / "recording.yaml").params
    assert found["keypoints"] == (f"left={folder / 'a.json'}", str(folder / "b.json"))
    assert found["cameras"] == "-"
    assert found["output"] == folder / "../out"
    assert found["align"] == Path("/x/marks.csv")
    assert found["model"] == str(folder / "mine")
    assert found["axes"] == "cam1"
    saved = option_files.format_options(
        parse("--config", folder / "recording.yaml"), Path("elsewhere/recording.yaml")
    )
    assert "  - left=../sessions/one/a.json\n" in saved
    assert "model: ../sessions/one/mine\n" in saved
    assert "world: cam1\n" in saved


def test_the_command_line_wins(tmp_path):
    path = tmp_path / "recording.yaml"
    path.write_text("seed: 3\nfps: [30, cam1:60]\nsync: off\n", "utf-8")
    found = parse("k", "-o", "o", "--config", path, "--seed", 5, "--fps", 25).params
    assert (found["seed"], found["fps"], found["sync"]) == (5, ("25",), "off")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("seed: 1\nimage_size: 3x3", ":2: expected the name of an option, found image_size; "),
        ("seed: 1\nimage_size: 3x3", "did you mean image-size?"),
        ("seed: 1\nhelp: true", ":2: expected the name of an option, found help"),
        ("seed: 1\n\nseed: 2", ":3: expected each option once, found seed twice"),
        ("\nseed: -1", ":2: seed: expected a whole number of 0 or more, found -1"),
        ("sync: maybe", ":1: sync: expected one of auto, check, off, found maybe"),
        ("strict: 7", ":1: strict: expected true or false, found 7"),
        ("focal-uncertainty: 5 px", ":1: focal-uncertainty: expected a share of up to 100%"),
        ("seed: [1, 2]", ":1: seed: expected one value, found a list of 2"),
        ("fps:\n  - cam1: 7", ":2: expected a value for fps, or a list of values, found a mapping"),
        ("seed:", ":1: expected a value for seed, found none"),
        ("write: []", ":1: expected a value for write, found none"),
        ("- seed", ":1: expected lines `option: value`, found a list"),
        ("seed: 1\n  fps: 3", ":2: expected YAML, found mapping values are not allowed here"),
        ("seed: " + "[" * 5000, ": expected YAML, found "),
        ("x" * 200_000, ": expected a file of options, below 100 kB, found 200 kB"),
        ("fps: [30, 60, cam1:x]", ":1: fps: expected frames per second above 0, or camera:"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(text, said, tmp_path, monkeypatch):
    """What was expected, what came, what to do; before anything is written."""
    monkeypatch.chdir(tmp_path)
    Path("recording.yaml").write_text(text, "utf-8")
    with pytest.raises(MocapCalibError) as error:
        run.main(["k", "-o", "o", "--config", "recording.yaml"], standalone_mode=False)
    assert f"recording.yaml{said}" in str(error.value) or said in str(error.value)
    assert ";" in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["recording.yaml"]


def test_a_wrong_value_of_the_command_line_is_not_blamed_on_the_file(tmp_path):
    path = tmp_path / "recording.yaml"
    path.write_text("fps: 30\n", "utf-8")
    words = ["k", "-o", tmp_path / "o", "--config", path, "--fps", "cam1:x"]
    with pytest.raises(click.BadParameter):
        run.main([str(word) for word in words], standalone_mode=False)


def test_a_file_that_says_something_else_is_not_replaced(tmp_path):
    context = parse("k", "-o", "o", "--seed", 3)
    path = tmp_path / "recording.yaml"
    for _ in range(2):
        option_files.save_options(context, path)
    path.write_text(path.read_text("utf-8") + "# mine\n", "utf-8")
    with pytest.raises(MismatchError, match="expected a new file"):
        option_files.save_options(context, path)
    assert "# mine" in path.read_text("utf-8")


def test_a_saved_run_can_be_made_again_in_a_batch(small, tool, tmp_path):
    """The same numbers from the command line, and from its file in the folder of a recording."""
    session = tmp_path / "one"
    shutil.copytree(small / "keypoints", session / "keypoints")
    save = ("--save-config", session / "recording.yaml")
    cameras = ("--cameras", small / "intrinsics.toml")
    kept = ("--frame-offset", "cam2:0", "--individuals", 2, "--seed", 3)
    first = tool("run", session / "keypoints", *cameras, *kept, "-o", tmp_path / "first", *save)
    assert first.returncode == 0, first.stderr
    second = tool("batch", session, "-o", tmp_path / "second")
    assert second.returncode == 0, second.stderr
    run_report, batch_report = (
        json.loads((tmp_path / folder / "run.json").read_text("utf-8"))
        for folder in ("first", "second/one")
    )
    assert run_report["seed"] == 3
    for key in ("cameras", "individuals", "verdict", "seed", "config"):
        assert batch_report[key] == run_report[key]


def test_a_wrong_file_stops_a_batch_before_it_starts(small, tool, tmp_path):
    for name in ("one", "two"):
        shutil.copytree(small / "keypoints", tmp_path / name / "keypoints")
    (tmp_path / "two" / "recording.yaml").write_text("seed: 1\nmirrored: cam1\nside: cam1\n")
    done = tool("batch", tmp_path / "one", tmp_path / "two", "-o", tmp_path / "out")
    assert done.returncode == 1
    assert "two/recording.yaml:3: expected the name of an option, found side; " in done.stderr
    assert "did you mean sides?" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_page_says_what_holds(tmp_path):
    """Its example is a file that is read, and it names the options that are the batch's own."""
    page = (ROOT / "docs" / "recording-yaml.md").read_text("utf-8")
    whole_batch = OPTIONS.keys() - {
        key for key, param in OPTIONS.items() if param.name in OF_RECORDINGS
    }
    assert all(f"`{name}`" in page.split("## In a batch")[1] for name in whole_batch)
    path = tmp_path / "recording.yaml"
    path.write_text(page.split("```yaml\n")[1].split("```")[0], "utf-8")
    found = parse("--config", path).params
    assert found["keypoints"] == (str(tmp_path / "keypoints"),)
    assert found["frame_offset"] == ("cam1:-3", "cam2:5")
    assert found["strict"] is True


def request_of(folder: Path) -> None:
    """Make of the options in a folder what `run` makes of them before it reads a recording."""
    params = parse(folder, "-o", folder / "out", "--config", folder / "a.yaml").params
    known = SharedOptions.__dataclass_fields__
    shared = SharedOptions(**{name: params[name] for name in params if name in known})
    calibration_request(shared, folder / "out")


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000, "1\n2"])
@pytest.mark.parametrize(
    "key",
    ["image-size", "layout", "frame-offset", "resized", "sync-window", "height", "length"]
    + ["camera-distance"],
)
def test_a_long_or_broken_value_is_refused_in_one_short_line(tmp_path, key, value):
    (tmp_path / "a.yaml").write_text(json.dumps({key: value}), "utf-8")
    with pytest.raises((MocapCalibError, click.ClickException)) as caught:
        request_of(tmp_path)
    error = caught.value
    said = error.format_message() if isinstance(error, click.ClickException) else str(error)
    assert "\n" not in said
    assert len(said) < 1500
