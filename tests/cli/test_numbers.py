"""Options that are numbers: one line of usage says what was expected."""

import importlib

import pytest
from click.testing import CliRunner

from mocap_calib_cli.main import COMMANDS

GIVEN = {
    "run": ["keypoints", "--cameras", "i.toml", "-o", "out"],
    "batch": ["a", "b", "--cameras", "i.toml", "-o", "out"],
    "convert": ["a.h5", "b.trc"],
    "simulate": ["-o", "out"],
    "train": ["-o", "out"],
}


@pytest.mark.parametrize(
    ("command", "option", "value", "expected"),
    [
        ("run", "--seed", "abc", "a whole number of 0 or more"),
        ("batch", "--seed", "-1", "a whole number of 0 or more"),
        ("batch", "--jobs", "0", "a whole number of 1 or more"),
        ("convert", "--fps", "nan", "a number above 0"),
        ("simulate", "--frames", "1e3", "a whole number of 1 or more"),
        ("simulate", "--noise", "inf", "a number of 0 or more"),
        ("simulate", "--missing", "5%", "a number from 0 to 1"),
        ("simulate", "--arc", "400", "a number from 0 to 360"),
        ("train", "--width", "3", "a whole number of 4 or more"),
    ],
)
def test_what_is_no_such_number_is_wrong_usage(command, option, value, expected):
    assert command in COMMANDS
    module = importlib.import_module(f"mocap_calib_cli.commands.{command}")
    done = CliRunner().invoke(module.command, [*GIVEN[command], option, value])
    assert (done.exit_code, done.stdout) == (2, "")
    line = f"Error: Invalid value for '{option}': expected {expected}, found {value}"
    assert done.stderr.splitlines()[-1] == line
