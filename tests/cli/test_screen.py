"""Tables and verdicts on terminals of any width, and plain text elsewhere."""

import io

import pytest
from rich.console import Console

from mocap_calib.results import VERDICTS
from mocap_calib_cli.screen import Line, Table, format_table, show
from mocap_calib_cli.verdicts import STYLES

LONG = "courtyard_[bold]_north_" * 3
MANY = Table(
    ("camera", "detections", "matched", "error px", "sigma deg", "clock", "focal px", "faults"),
    (
        (LONG, "123456", "123456", "1.50", "0.03", "+0.30", "1097 +- 1", "moved, sides (mended)"),
        *((f"cam{k}", "608", "600", "1.59", "0.02", "-", "1097 +- 1", "-") for k in range(30)),
    ),
    "faults",
)


def shown(*parts: Table | Line, width: int = 80) -> str:
    """What a terminal of a width gets."""
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=width, color_system="standard")
    show(*parts, err=True, console=console)
    return screen.getvalue()


def test_a_terminal_of_80_columns_holds_31_cameras_and_all_of_a_long_name(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    lines = shown(MANY).replace("\x1b[1m", "").replace("\x1b[0m", "").splitlines()
    assert max(map(len, lines)) <= 80
    assert LONG.replace("_", "") in "".join(line[:14].strip(" _─") for line in lines).replace(
        "_", ""
    )
    assert "moved,sides(mended)" in "".join(line[66:].strip() for line in lines).replace(" ", "")
    assert sum(line.startswith("cam") for line in lines) == 31  # and the header
    assert all(line.split()[1:3] == ["608", "600"] for line in lines if line.startswith("cam2"))


def test_colours_are_shown_where_they_are_wanted(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert set(STYLES) == set(VERDICTS)
    verdict = Line("rig weak [check]", STYLES["weak"])
    assert shown(verdict) == "\x1b[1;33mrig weak [check]\x1b[0m\n"
    monkeypatch.setenv("NO_COLOR", "1")
    assert "33" not in shown(verdict)


def test_off_a_terminal_a_row_is_a_line_and_its_cells_are_apart(capsys):
    show(MANY, Line("next: x", "bold"), err=True)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 + 31 + 1
    assert lines[-1] == "next: x"
    assert [line.split()[0] for line in lines[1:3]] == [LONG, "cam0"]
    assert lines[1].endswith("  1097 +- 1  moved, sides (mended)")


@pytest.mark.parametrize("rows", [[], [["a", "-", "-"]], [["a", "1.5", "in place"]]])
def test_numbers_stand_to_the_right_and_words_to_the_left(rows):
    lines = format_table(["camera", "error px", "place"], rows)
    assert lines[0].split() == ["camera", "error", "px", "place"]
    if rows == [["a", "1.5", "in place"]]:
        assert lines == ["camera  error px  place", "a            1.5  in place"]
