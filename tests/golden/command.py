"""Call `mocap-calib` within this process: its streams are memory, its exit status is returned."""

import contextlib
import io
import sys
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from mocap_calib_cli.main import main

threadpool_limits(1)  # as in a process of the command, which says so before numpy is imported


@dataclass(frozen=True)
class Outcome:
    """Exit status, stdout and the lines of stderr of a command."""

    status: int
    stdout: bytes
    stderr: tuple[str, ...]


class _Streams:
    """stdin, stdout and stderr of a command, as `sys` has them."""

    def __init__(self, stdin: bytes) -> None:
        self.stdin = io.TextIOWrapper(io.BytesIO(stdin), encoding="utf-8")
        self.stdout, self.stderr = (
            io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in "oe"
        )

    def written(self, name: str) -> bytes:
        """Return the bytes written to a stream."""
        stream = getattr(self, name)
        stream.flush()
        return stream.buffer.getvalue()


@contextlib.contextmanager
def _as_system(streams: _Streams, words: list[str]):
    """Let `sys` have the streams and the arguments for a while."""
    replaced = {"argv": ["mocap-calib", *words], **vars(streams)}
    before = {name: getattr(sys, name) for name in replaced}
    for name, value in replaced.items():
        setattr(sys, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(sys, name, value)


def call(*words: object, folder: Path, stdin: bytes = b"") -> Outcome:
    """Return the outcome of `mocap-calib WORDS` in a folder.

    Exceptions other than SystemExit pass: the command would end with a traceback.
    """
    streams = _Streams(stdin)
    status: object = 0
    with contextlib.chdir(folder), _as_system(streams, [str(word) for word in words]):
        try:
            main()
        except SystemExit as end:
            status = end.code or 0
    assert isinstance(status, int), status
    lines = streams.written("stderr").decode("utf-8").splitlines()
    return Outcome(status, streams.written("stdout"), tuple(lines))
