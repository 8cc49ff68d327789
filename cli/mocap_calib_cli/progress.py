"""What is written to stderr while a command works; stdout is for data."""

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

import click

from mocap_calib.errors import count
from mocap_calib_cli import screen

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from mocap_calib_cli.screen import Shown

_BAR_AFTER = 1.0  # seconds before a stage gets a bar
_LINE_AFTER = 30.0  # seconds without a line where stderr is no terminal


class Reporter:
    """Implements `types.Progress`, and writes whatever else there is to say to stderr.

    On a terminal, a stage that lasts longer than a second has a bar; elsewhere a stage has a line
    when it is finished. Nothing but warnings is written when `quiet`. Use it as a context: a stage
    that failed is not reported as finished.
    """

    def __init__(self, *, quiet: bool) -> None:
        self.quiet = quiet
        self.terminal = sys.stderr.isatty()
        self.stage = ""
        self.done = 0
        self.total = 0
        self.stage_start = time.monotonic()
        self.last_line = self.stage_start
        self.bars: Progress | None = None
        self.bar: TaskID | None = None

    def say(self, *lines: str) -> None:
        """Write lines to stderr."""
        if not self.quiet:
            self.warn(*lines)

    def warn(self, *lines: str) -> None:
        """Write lines to stderr that nobody may miss, also when `quiet`."""
        for line in lines:
            click.echo(line, err=True)

    def show(self, *parts: "Shown") -> None:
        """Show tables and lines in colour on stderr, see `screen.show`."""
        if not self.quiet:
            screen.show(*parts, err=True)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Tell that `done` of `total` steps of `stage` are finished.

        What stands in parentheses after the name of the stage may change.
        """
        if self.quiet:
            return
        if _plain_name(stage) != _plain_name(self.stage):
            self._finish_stage()
        self.stage = stage
        self.done = done
        self.total = total
        if self.terminal:
            self._show_bar()
        else:
            self._show_line()
        if done >= total:
            self._finish_stage()

    def _show_bar(self) -> None:
        """Bring the bar of the stage up to date."""
        if self.bar is None and time.monotonic() - self.stage_start > _BAR_AFTER:
            self.bars = self.bars or _start_bars()
            self.bar = self.bars.add_task(self.stage)
        if self.bars is not None and self.bar is not None:
            self.bars.update(
                self.bar, description=self.stage, completed=self.done, total=self.total
            )

    def _show_line(self) -> None:
        """Write a line on the stage if there was none for long."""
        silence = time.monotonic() - max(self.stage_start, self.last_line)
        if silence > _LINE_AFTER and self.done < self.total:
            self.last_line = time.monotonic()
            self.say(f"{self.stage}: {self.done} of {self.total}{self._time_left()}")

    def _time_left(self) -> str:
        """Say how long the stage takes yet, if its steps go on as they did."""
        if self.done <= 0:
            return ""
        spent = time.monotonic() - self.stage_start
        return f", about {spent * (self.total - self.done) / self.done:.0f} s left"

    def _finish_stage(self) -> None:
        """Close the stage: it did all its steps, or another has begun."""
        now = time.monotonic()
        if self.stage and not self.terminal:
            self.say(f"{self.stage}: done in {now - self.stage_start:.1f} s{self._saved_steps()}")
        if self.bars is not None and self.bar is not None:
            self.bars.update(self.bar, completed=self.done, total=self.done)
        self.stage = ""
        self.bar = None
        self.stage_start = now

    def _saved_steps(self) -> str:
        """Say that the stage needed fewer steps than it might have, if it did."""
        if self.done >= self.total:
            return ""
        return f" (needed {self.done} of at most {count(self.total, 'step')})"

    def __enter__(self) -> Self:
        self.stage_start = time.monotonic()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._finish_stage()
        if self.bars is not None:
            self.bars.stop()


def _plain_name(stage: str) -> str:
    """Return the name of a stage without what stands in parentheses after it."""
    return stage.partition(" (")[0]


def _start_bars() -> "Progress":
    """Start bars on stderr. rich is imported here because it takes a while."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    bars.start()
    return bars
