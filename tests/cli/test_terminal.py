"""What a terminal shows, of any width; plain text elsewhere is in the other tests."""

import os
import re
import subprocess

import pytest
from conftest import TOOL
from platforms import posix

LONG = "courtyard_[bold]_north_" * 3
CODES = re.compile(r"\x1b\[[\d;]*m")


def shown(*words: object, width: int = 80, environment: dict[str, str] | None = None) -> list[str]:
    """The lines that a command writes to a terminal, of stdout and stderr."""
    import fcntl
    import struct
    import termios

    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, width, 0, 0))
    known = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "COLUMNS")}
    process = subprocess.Popen(
        [TOOL, *map(str, words)],
        stdin=subprocess.DEVNULL,
        stdout=theirs,
        stderr=theirs,
        env={**known, "TERM": "xterm", **(environment or {})},
    )
    os.close(theirs)
    content = b""
    try:
        while more := os.read(ours, 10_000):
            content += more
    except OSError:  # as Linux says that the other end is closed
        pass
    os.close(ours)
    assert process.wait() in (0, 1)
    return content.decode().replace("\r\n", "\n").split("\n")


@posix
@pytest.mark.parametrize("environment", [{}, {"NO_COLOR": "1"}], ids=["colours", "plain"])
def test_a_terminal_holds_all_of_a_long_name_and_the_verdict_in_colour(
    environment, small, tmp_path
):
    """Names are text, whatever brackets they have; what is too long goes on below."""
    files = dict.fromkeys(("cam1", "cam2", "cam3"), "")
    files["cam2"] = LONG
    text = (small / "reference.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace('"cam2"', f'"{LONG}"'))
    keypoints = [f"{new or old}={small / 'keypoints' / old}.json" for old, new in files.items()]
    words = ("verify", tmp_path / "rig.toml", *keypoints, "--quiet")
    lines = shown(*words, environment=environment)
    plain = [CODES.sub("", line) for line in lines]
    table = plain[: next(k for k, line in enumerate(plain) if line.startswith("calibration: "))]
    assert max(map(len, table)) <= 80
    first = "".join(line[: line.index("  ")] if "  " in line else line for line in table)
    assert re.sub(r"\s", "", LONG) in re.sub(r"\s", "", first)
    assert sum(line.startswith("cam") for line in table) == 3  # and the header
    verdict = next(line for line in lines if "calibration: " in line)
    assert ("\x1b[1;32m" in verdict) == (not environment)
