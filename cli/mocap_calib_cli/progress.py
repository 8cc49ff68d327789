"""What is said on stderr while a command works; stdout is for data."""

import sys
import time
from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

import click

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_PATIENCE = 1.0  # seconds before a stage gets a bar
_SILENCE = 30.0  # seconds without a line when stderr is no terminal


class Reporter:
    """Implements `types.Progress`: bars on a terminal for what lasts longer than a second, else a line per finished stage.

    Also says whatever else there is to say on stderr; nothing when `quiet`. Use it as a context: a failed stage is not
    reported as finished.
    """

    def __init__(self, *, quiet: bool) -> None:
        self.quiet = quiet
        self.terminal = sys.stderr.isatty()
        self.stage, self.done, self.total = "", 0, 0
        self.since = self.spoken = time.monotonic()
        self.bars: Progress | None = None
        self.bar: TaskID | None = None

    def say(self, *lines: str) -> None:
        """Lines on stderr."""
        for line in () if self.quiet else lines:
            click.echo(line, err=True)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of `total` steps of `stage` are finished; what stands in parentheses after its name may change."""
        if self.quiet:
            return
        if stage.partition(" (")[0] != self.stage.partition(" (")[0]:
            self._finish()
        self.stage, self.done, self.total = stage, done, total
        (self._show_bar if self.terminal else self._show_line)()
        if done >= total:
            self._finish()

    def _show_bar(self) -> None:
        if self.bar is None and time.monotonic() - self.since > _PATIENCE:
            self.bars = self.bars or _bars()
            self.bar = self.bars.add_task(self.stage)
        if self.bars is not None and self.bar is not None:
            self.bars.update(
                self.bar, description=self.stage, completed=self.done, total=self.total
            )

    def _show_line(self) -> None:
        if time.monotonic() - max(self.since, self.spoken) > _SILENCE and self.done < self.total:
            self.spoken = time.monotonic()
            self.say(f"{self.stage}: {self.done} of {self.total}")

    def _finish(self) -> None:
        """The stage has ended: it did all its steps, or another has begun."""
        now = time.monotonic()
        if self.stage and not self.terminal:
            self.say(f"{self.stage}: {self.done} of {self.total} in {now - self.since:.1f} s")
        if self.bars is not None and self.bar is not None:
            self.bars.update(self.bar, completed=self.done, total=self.done)
        self.stage, self.bar, self.since = "", None, now

    def __enter__(self) -> Self:
        self.since = time.monotonic()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._finish()
        if self.bars is not None:
            self.bars.stop()


def _bars() -> "Progress":
    """Bars on stderr; imported here because rich takes a while."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
    )
    bars.start()
    return bars


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of aligned columns: the first to the left, the others to the right. The same in a terminal, a pipe and a log."""
    cells = [list(header), *map(list, rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    return [
        "  ".join(
            [
                row[0].ljust(widths[0]),
                *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)),
            ]
        ).rstrip()
        for row in cells
    ]


def figure(value: float | None, digits: int = 2) -> str:
    """A number for a table; a dash where there is none."""
    return "-" if value is None or value != value else f"{value:.{digits}f}"  # noqa: PLR0124 - NaN
