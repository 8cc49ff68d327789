"""`--config` and `--save-config`: options in files mean what they mean on the command line."""

import json
import re
import shutil
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "recording-yaml.md"
# a value that is not the default, or several, of each option; ODD is hard to write in YAML
ODD = "1:30"
VALUES: dict[str, str | list[str]] = {
    "cameras": "intrinsics.toml",
    "refine": "focal+k1",
    "centre-uncertainty": "0.2%",
    "focal-uncertainty": "7%",
    "focal-per-camera": "true",
    "skeleton": "mine.yaml",
    "model": "quadruped",
    "device": "cuda",
    "individuals": "3",
    "pairs": "all",
    "solver": "paper",
    "seed": "3",
    "format": "csv",
    "layout": "nose, left ear,right ear",
    "image-size": ["640x480", "on:320X240"],
    "camera-regex": "(cam[0-9]+): #'\"x{2}",
    "frame-offset": [ODD, "on:-3", "é ß 日本 😀:0x10:007"],
    "crop-offset": ["a: b:640,0.5"],
    "views": "-,~",
    "mirrored": ["on", "null", "~", "- x", "[x", "*a", "!x", "%a", "@a", "---", "<<", "=", "? x"],
    "flipped": ["a"],
    "sides": ["'", '"', "a\nb", "\t", "{x}", "&a", "x:", " ", "a #b"],
    "rotated": ["cam1:90"],
    "resized": ["cam1:0.5", "cam2:1,0.75"],
    "exchanged": ["cam1,cam2"],
    "moved": ["cam1:500", "cam1:700"],
    "mend": "none",
    "sync": "off",
    "sync-window": "7",
    "world": "cam1",
    "height": ["0=1.75+-0.01"],
    "length": ["left_hip-left_knee=0.42"],
    "camera-distance": ["a-b=3.1±0.02"],
    "forward": "tail-nose",
    "smooth": "bones",
    "write": ["colmap", "npz"],
    "fps": ["30", "cam1:60"],
    "report": "false",
    "strict": "true",
    "quiet": "true",
    "json": "true",
}
APART = {"accept": "not-determined", "align": "marks.csv"}  # not with --strict, --world
SCHEDULER = {"scheduler": "nothing://a:1"}  # importing Dask takes four seconds
FLAGS = {"true": "--{}", "false": "--no-{}"}
MARKS = "name,x,y,z,camera,u,v\na,0,0,0,cam1,1,2\nb,1,0,0,cam1,3,4\nc,0,1,0,cam1,5,6\n"


def typed(values: dict[str, str | list[str]]) -> list[str]:
    """The options as words of a command line."""
    words = []
    for name, value in values.items():
        for each in value if isinstance(value, list) else [value]:
            words += [FLAGS[each].format(name)] if each in FLAGS else [f"--{name}={each}"]
    return words


def saved(tool, folder: Path, *words: str) -> str:
    """What --save-config writes, before the keypoints that are not there are read."""
    done = tool("run", *words, "--save-config", "saved.yaml", cwd=folder)
    assert "Traceback" not in done.stderr
    path = folder / "saved.yaml"
    text = path.read_text("utf-8")
    path.unlink()
    return text


@pytest.mark.parametrize("values", [VALUES, APART, pytest.param(SCHEDULER, marks=pytest.mark.slow)])
def test_an_option_in_a_file_is_the_option_and_comes_back(values, tool, tmp_path):
    """Whatever YAML would make of its text: a number to base 60, a truth value, nothing."""
    (tmp_path / "marks.csv").write_text(MARKS, "utf-8")
    words = ("keypoints", "-o", "out")
    text = saved(tool, tmp_path, *words, *typed(values))
    (tmp_path / "one.yaml").write_text(text, "utf-8")
    assert saved(tool, tmp_path, "--config", "one.yaml") == text
    plain = {"keypoints": "keypoints", "output": "out"} | values
    (tmp_path / "two.yaml").write_text(json.dumps(plain, ensure_ascii=False), "utf-8")
    assert saved(tool, tmp_path, "--config", "two.yaml") == text
    given, others = text.split("# --- all other options")
    assert set(re.findall(r"^([a-z-]+):", given, re.M)) == plain.keys()
    listed = set(re.findall(r"^# ([a-z-]+): ", others, re.M))
    assert listed | plain.keys() >= {*VALUES, *APART, *SCHEDULER}
    assert not listed & plain.keys()


def test_all_options_are_tried(tool):
    """But for those that are of files."""
    text = tool("run", "--help").stdout
    known = set(re.findall(r"^  (?:-\w, )?--([a-z-]+)", text, re.M))
    assert known - {"help", "config", "save-config", "output"} == {*VALUES, *APART, *SCHEDULER}


def test_paths_are_those_beside_the_file(tool, tmp_path):
    """Words that are no paths stay as they are, and so does the standard input."""
    folder = tmp_path / "sessions" / "one"
    folder.mkdir(parents=True)
    (folder / "mine").touch()
    (folder / "marks.csv").write_text(MARKS, "utf-8")
    (folder / "recording.yaml").write_text(
        "keypoints: [left=a.json, b.json]\ncameras: '-'\noutput: ../out\nalign: marks.csv\n"
        "model: mine\nskeleton: /x/joints.yaml\nmirrored: b.json\n",
        "utf-8",
    )
    (tmp_path / "else").mkdir()
    words = ("run", "--config", "sessions/one/recording.yaml", "--save-config", "else/a.yaml")
    tool(*words, cwd=tmp_path)
    lines = (tmp_path / "else" / "a.yaml").read_text("utf-8").splitlines()
    for line in (
        "  - left=../sessions/one/a.json",
        "  - ../sessions/one/b.json",
        'cameras: "-"',
        "output: ../sessions/out",
        "align: ../sessions/one/marks.csv",
        "model: ../sessions/one/mine",
        "mirrored: b.json",
    ):
        assert line in lines
    assert any(line.startswith("skeleton: ") and line.endswith("/x/joints.yaml") for line in lines)


def test_the_command_line_wins(tool, tmp_path):
    (tmp_path / "a.yaml").write_text("seed: 3\nfps: [30, cam1:60]\nsync: off\n", "utf-8")
    words = ("k", "-o", "o", "--config", "a.yaml", "--seed", "5", "--fps", "25")
    lines = saved(tool, tmp_path, *words).splitlines()
    assert {"seed: 5", "fps: 25", "sync: off"} <= set(lines)
    wrong = tool("run", *words, "--fps", "cam1:x", cwd=tmp_path)  # is not blamed on the file
    assert wrong.returncode == 2
    assert "a.yaml" not in wrong.stderr


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("seed: 1\nimage_size: 3x3", "did you mean image-size?"),
        ("seed: 1\nhelp: true", ":2: expected the name of an option, found help"),
        ("seed: 1\n\nseed: 2", ":3: expected each option once, found seed twice"),
        ("\nseed: -1", ":2: seed: expected a whole number of 0 or more, found -1"),
        ("strict: 7", ":1: strict: expected true or false, found 7"),
        ("seed: [1, 2]", ":1: expected a value for seed, found a list of 2"),
        ("fps:\n  - cam1: 7", ":2: expected a value for fps, found a mapping"),
        ("seed:", ":1: expected a value for seed, found none"),
        ("- seed", ":1: expected lines `option: value`, found a list"),
        ("[a]: 1", ":1: expected the name of an option, found a list"),
        ("seed: 1\n  fps: 3", ":2: expected YAML, found mapping values are not allowed here"),
        ("seed: " + "[" * 5000, ": expected YAML, found "),
        ("x" * 200_000, ": expected a file of options, below 100 kB, found 200 kB"),
        ('cameras: "a\\0b"', ":1: cameras: expected the name of a file, found 'a\\x00b'"),
        ("\nfps: cam1:60", ":2: fps: expected that of the other cameras too, as --fps 30"),
        *((f"{key}: '{'9' * 5000}'", f":1: {key}: expected ") for key in ("image-size", "height")),
        *((f'{key}: "1\\n2"', f":1: {key}: expected ") for key in ("resized", "frame-offset")),
    ],
)
def test_what_is_wrong_is_said_with_its_line(text, said, tool, tmp_path):
    """What was expected, what came, what to do, in one short line; before anything is written."""
    (tmp_path / "recording.yaml").write_text(text, "utf-8")
    done = tool("run", "k", "-o", "o", "--config", "recording.yaml", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert f"recording.yaml{said}" in done.stderr or said in done.stderr
    assert ";" in done.stderr
    assert len(done.stderr) < 1500
    assert [path.name for path in tmp_path.iterdir()] == ["recording.yaml"]


def test_a_file_that_says_something_else_is_not_replaced(tool, tmp_path):
    words = ("run", "k", "-o", "o", "--seed", 3, "--save-config", "a.yaml")
    for _ in range(2):
        assert "expected a new file" not in tool(*words, cwd=tmp_path).stderr
    path = tmp_path / "a.yaml"
    path.write_text(path.read_text("utf-8") + "# mine\n", "utf-8")
    done = tool(*words, cwd=tmp_path)
    assert (done.returncode, "a.yaml: expected a new file" in done.stderr) == (1, True)
    assert "# mine" in path.read_text("utf-8")


def test_a_saved_run_can_be_made_again_in_a_batch(small, tool, tmp_path):
    """The same numbers from the command line, and from its file in the folder of a recording."""
    session = tmp_path / "one"
    shutil.copytree(small / "keypoints", session / "keypoints")
    save = ("--save-config", session / "recording.yaml")
    cameras = ("--cameras", small / "intrinsics.toml")
    kept = ("--frame-offset", "cam2:0", "--individuals", 2, "--seed", 3, "--smooth", "off")
    first = tool("run", session / "keypoints", *cameras, *kept, "-o", tmp_path / "first", *save)
    assert first.returncode == 0, first.stderr
    second = tool("batch", session, "-o", tmp_path / "second", "--seed", 4, "--smooth", "bones")
    assert second.returncode == 0, second.stderr
    run, batch = (
        json.loads((tmp_path / folder / "run.json").read_text("utf-8"))
        for folder in ("first", "second/one")
    )
    assert (run["seed"], batch["seed"]) == (3, 4)  # what was typed wins
    assert batch["config"]["poses"].pop("smooth") == "bones"
    assert run["config"]["poses"].pop("smooth") == "off"
    for key in ("individuals", "config"):
        assert batch[key] == run[key]
    reading = {"keypoints": [str(session / "keypoints")], "frame_offset": ["cam2:0"]}
    assert run["reading"] == reading
    assert batch["reading"].keys() == reading.keys()


def test_a_wrong_file_stops_a_batch_before_it_starts(small, tool, tmp_path):
    for name in ("one", "two"):
        shutil.copytree(small / "keypoints", tmp_path / name / "keypoints")
    (tmp_path / "two" / "recording.yaml").write_text("seed: 1\nmirrored: cam1\nside: cam1\n")
    done = tool("batch", tmp_path / "one", tmp_path / "two", "-o", tmp_path / "out")
    assert done.returncode == 1
    assert "two/recording.yaml:3: expected the name of an option, found side; " in done.stderr
    assert "did you mean sides?" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_page_says_what_holds(tool, tmp_path):
    """Its example is a file that is read, and it names the options that are the batch's own."""
    page = PAGE.read_text("utf-8")
    for name in ("output", "json", "strict", "accept", "scheduler", "quiet"):
        assert f"`{name}`" in page.split("## In a batch")[1]
    (tmp_path / "recording.yaml").write_text(page.split("```yaml\n")[1].split("```")[0], "utf-8")
    text = saved(tool, tmp_path, "--config", "recording.yaml")
    assert "frame-offset:\n  - cam1:-3\n  - cam2:5\n" in text
    assert "\nstrict: true\n" in text
