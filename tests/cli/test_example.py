"""`mocap-calib example`: what a newcomer gets works as its README says."""

import re
import shlex

import pytest
from click.testing import CliRunner

from mocap_calib.errors import MismatchError
from mocap_calib.synthetic.config import EXAMPLES
from mocap_calib_cli.commands.example import command


def lay_out(*words: object) -> str:
    done = CliRunner().invoke(command, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return done.stdout


def content(folder) -> dict[str, bytes]:
    files = (file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def test_without_a_name_they_are_listed():
    listed = [line.split()[0] for line in lay_out().splitlines()]
    assert listed == list(EXAMPLES) == ["people", "dog", "mouse"]


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_is_small_complete_and_the_same_every_time(name, tmp_path):
    lay_out(name, "-o", tmp_path / "one")
    lay_out(name, "-o", tmp_path / "two")
    files = content(tmp_path / "one")
    assert files == content(tmp_path / "two")
    assert {"README.md", "intrinsics.toml", "reference.toml", "keypoints/cam1.json"} <= set(files)
    assert sum(map(len, files.values())) < 500_000  # measured 373,000 for two people
    lay_out(name, "-o", tmp_path / "one")  # what is there already is no obstacle


def test_files_of_others_are_left_alone(tmp_path):
    (tmp_path / "README.md").write_text("mine", "utf-8")
    with pytest.raises(MismatchError, match="expected a new folder"):
        lay_out("dog", "-o", tmp_path)
    assert content(tmp_path) == {"README.md": b"mine"}


@pytest.mark.slow
def test_the_commands_of_its_readme_work(tool, tmp_path):
    """Measured 0.06 degrees for the worst pair of cameras; 0.05 of people, 0.10 of the mouse."""
    lay_out("dog", "-o", tmp_path)
    readme = (tmp_path / "README.md").read_text("utf-8")
    commands = re.findall(r"^    mocap-calib (.*)$", readme, re.MULTILINE)
    assert len(commands) == 3
    inspected, ran, evaluated = (tool(*shlex.split(words), cwd=tmp_path) for words in commands)
    assert inspected.returncode == ran.returncode == evaluated.returncode == 0
    assert "nothing stands in the way" in inspected.stdout
    assert "rig well determined" in ran.stderr
    worst = re.search(r"^max +(\S+)", evaluated.stdout, re.MULTILINE)
    assert float(worst[1]) < 0.25
