"""What is said of stages while a command works."""

import re

import pytest

from mocap_calib_cli.interrupted import say_how_to_go_on
from mocap_calib_cli.progress import Reporter


def said_of(capsys, *steps) -> list[str]:
    with Reporter(quiet=False) as reporter:
        for step in steps:
            reporter(*step)
    return re.sub(r"\d+\.\d s", "T", capsys.readouterr().err).splitlines()


def test_a_stage_that_needed_fewer_steps_is_done_and_not_aborted(capsys):
    assert said_of(capsys, ("adjust", 1, 6), ("adjust", 3, 6), ("match all", 7, 7)) == [
        "adjust: done in T (needed 3 of at most 6 steps)",
        "match all: done in T",
    ]


def test_the_last_stage_is_done_too(capsys):
    assert said_of(capsys, ("pairwise", 6, 6), ("adjust", 2, 6)) == [
        "pairwise: done in T",
        "adjust: done in T (needed 2 of at most 6 steps)",
    ]


def test_a_long_stage_says_how_long_it_takes_yet(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    with Reporter(quiet=False) as reporter:
        reporter("match all", 0, 10)
        now[0] = 40.0
        reporter("match all", 4, 10)
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "match all: 4 of 10, about 60 s left"


@pytest.mark.parametrize("pairs", [0, 3])
def test_a_run_that_is_interrupted_says_what_it_kept(capsys, tmp_path, pairs):
    for number in range(pairs):
        (tmp_path / ".unfinished").mkdir(exist_ok=True)
        (tmp_path / ".unfinished" / f"{number}.json").touch()
    with pytest.raises(KeyboardInterrupt), say_how_to_go_on(Reporter(quiet=True), tmp_path):
        raise KeyboardInterrupt
    said = capsys.readouterr().err
    assert said == "" if not pairs else said.startswith("3 pairs of cameras kept in ")
    assert ("the same command goes on from there" in said) == bool(pairs)
