"""Text of the command line on every system: its encoding, its line ends, names with accents."""

import io
import os
import subprocess
import sys
import unicodedata

import pytest
from conftest import TOOL

from mocap_calib.compute import BLAS_THREADS
from mocap_calib_cli import main


def test_what_is_written_is_utf8_with_plain_line_ends(monkeypatch):
    """As on Windows, where files and pipes have the code page of the country."""
    written = {name: io.BytesIO() for name in ("stdout", "stderr")}
    for name, stream in written.items():
        text = io.TextIOWrapper(stream, encoding="cp1252", errors="backslashreplace", newline=None)
        monkeypatch.setattr(sys, name, text)
    main._speak_utf8()
    for name, stream in written.items():
        getattr(sys, name).write("łódź1 \udcff\n")
        getattr(sys, name).flush()
        assert stream.getvalue() == "łódź1 \\udcff\n".encode()


def test_a_stream_of_another_kind_is_left_alone(monkeypatch):
    """Such as a notebook's, or none."""
    for stream in (io.StringIO(), None):
        monkeypatch.setattr(sys, "stdout", stream)
        main._speak_utf8()
        assert sys.stdout is stream


def test_the_libraries_of_the_command_compute_on_one_thread(monkeypatch):
    """Accelerate, which numpy has on macOS, too; but where somebody says otherwise."""
    environment = {"OPENBLAS_NUM_THREADS": "2"}
    monkeypatch.setattr(main.os, "environ", environment)
    monkeypatch.setattr(main, "_run_command", lambda: 0)
    with pytest.raises(SystemExit):
        main.main()
    assert environment == {**dict.fromkeys(BLAS_THREADS, "1"), "OPENBLAS_NUM_THREADS": "2"}
    assert environment["VECLIB_MAXIMUM_THREADS"] == "1"


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
