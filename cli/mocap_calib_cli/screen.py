"""What a person sees: lines, tables and progress, in colour on a terminal, plain text elsewhere.

rich draws what a terminal shows. It takes 0.03 s to import, and is not where no terminal is.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, NamedTuple

import click

from mocap_calib.errors import count, visible

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_NUMBER = tuple("+-0123456789")  # what a number, or the dash in its place, begins with
_BAR_AFTER = 1.0  # seconds before a stage gets a bar
_LINE_AFTER = 30.0  # seconds without a line where stderr is no terminal


class Table(NamedTuple):
    """Rows of cells below a header; alarming: the header of a column that says what is wrong."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    alarming: str = ""

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers, and dashes where there is none; never the first one."""
        columns = zip(*self.rows, strict=True) if self.rows else ()
        found = [all(cell.startswith(_NUMBER) for cell in cells) for cells in columns]
        return [False, *(found[1:] or [True] * (len(self.header) - 1))]


class Line(NamedTuple):
    """A line of text, and the colour in which a terminal shows it (a style of rich)."""

    text: str
    style: str = ""


def echo(text: str, *, err: bool = False, end: str = "\n") -> None:
    """Write text to stdout, or to stderr where `err`, with control characters escaped.

    Names of files may hold any; terminals obey them.
    """
    click.echo(visible(text, kept="\n\t") + end, err=err, nl=False)


def show(*parts: Table | Line, err: bool) -> None:
    """Write tables and lines to stdout, or to stderr where `err`.

    On a terminal rich wraps cells to its width, and heeds NO_COLOR. Names are text, whatever
    brackets they have.
    """
    if not (sys.stderr if err else sys.stdout).isatty():
        for part in parts:
            text = part.text if isinstance(part, Line) else "\n".join(format_table(*part[:2]))
            echo(text, err=err)
        return
    from rich.console import Console
    from rich.table import Table as Drawn
    from rich.text import Text

    console = Console(stderr=err, highlight=False)
    for part in parts:
        if isinstance(part, Line):
            console.print(Text(visible(part.text, kept="\n\t"), part.style), soft_wrap=True)
            continue
        drawn = Drawn(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        for name, number in zip(part.header, part.numeric, strict=True):
            drawn.add_column(
                name.replace(" ", "\n") if number else name,  # a unit below leaves room for names
                justify="right" if number else "left",
                no_wrap=number,
                overflow="fold",
                style="yellow" if name == part.alarming else "",
            )
        for row in part.rows:
            drawn.add_row(*(Text(visible(cell)) for cell in row))
        console.print(drawn)


def format_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines of aligned columns: numbers to the right, all else to the left."""
    numeric = Table(header, rows).numeric
    columns = []
    for number, cells in zip(numeric, zip(header, *rows, strict=True), strict=True):
        align, width = str.rjust if number else str.ljust, max(map(len, cells))
        columns.append([align(cell, width) for cell in cells])
    return ["  ".join(row).rstrip() for row in zip(*columns, strict=True)]


def format_number(value: float | None, digits: int = 2) -> str:
    """Return a number for a table, a dash where there is none (None or NaN)."""
    return "-" if value is None or value != value else f"{value:.{digits}f}"  # noqa: PLR0124 - NaN


def format_length(value: float | None) -> str:
    """Return a length to two significant digits, a dash where there is none."""
    return "-" if value is None else f"{value:.2g}"


def keep_lines(cases: Mapping[str, object]) -> list[str]:
    """Return the lines that say something.

    cases: line -> what it is about; empty, zero or false where there is nothing to say.
    """
    return [line for line, found in cases.items() if found]


class Reporter(AbstractContextManager["Reporter"]):
    """Implements `types.Progress`, and writes whatever else there is to say to stderr.

    On a terminal, a stage that lasts longer than a second has a bar; elsewhere a stage has a line
    when it is finished. Nothing but warnings is written when `quiet`. Use it as a context: a stage
    that failed is not reported as finished.
    """

    def __init__(self, *, quiet: bool) -> None:
        self.quiet = quiet
        self.terminal = sys.stderr.isatty()
        self.stage, self.done, self.total = "", 0, 0
        self.start = self.last_line = time.monotonic()
        self.bars: Progress | None = None
        self.bar: TaskID | None = None

    def say(self, *lines: str) -> None:
        """Write lines to stderr."""
        if not self.quiet:
            self.warn(*lines)

    def warn(self, *lines: str) -> None:
        """Write lines to stderr that nobody may miss, also when `quiet`."""
        for line in lines:
            echo(line, err=True)

    def show(self, *parts: Table | Line) -> None:
        """Show tables and lines in colour on stderr, see `show`."""
        if not self.quiet:
            show(*parts, err=True)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Take note that `done` of `total` steps of `stage` are finished.

        What stands in parentheses after the name of the stage may change.
        """
        if self.quiet:
            return
        if stage.partition(" (")[0] != self.stage.partition(" (")[0]:
            self._finish_stage()
        self.stage, self.done, self.total = stage, done, total
        if done >= total:
            self._finish_stage()
        elif self.terminal:
            self._show_bar()
        else:
            self._show_line()

    def _show_bar(self) -> None:
        """Bring the bar of the stage up to date."""
        if self.bar is None and time.monotonic() - self.start > _BAR_AFTER:
            self.bars = self.bars or _start_bars()
            self.bar = self.bars.add_task(self.stage)
        if self.bars is not None and self.bar is not None:
            self.bars.update(
                self.bar, description=self.stage, completed=self.done, total=self.total
            )

    def _show_line(self) -> None:
        """Write a line on the stage if there was none for long, with the time that it takes yet."""
        now = time.monotonic()
        if now - max(self.start, self.last_line) > _LINE_AFTER:
            self.last_line = now
            left = (now - self.start) * (self.total - self.done) / max(self.done, 1)
            about = f", about {left:.0f} s left" if self.done > 0 else ""
            self.say(f"{self.stage}: {self.done} of {self.total}{about}")

    def _finish_stage(self) -> None:
        """Close the stage: it did all its steps, or another has begun."""
        now = time.monotonic()
        if self.stage and not self.terminal:
            most = count(self.total, "step")
            few = f" (needed {self.done} of at most {most})" if self.done < self.total else ""
            self.say(f"{self.stage}: done in {now - self.start:.1f} s{few}")
        if self.bars is not None and self.bar is not None:
            self.bars.update(self.bar, completed=self.done, total=self.done)
        self.stage, self.bar, self.start = "", None, now

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._finish_stage()
        if self.bars is not None:
            self.bars.stop()


def _start_bars() -> "Progress":
    """Start bars on stderr."""
    from rich import progress
    from rich.console import Console

    bars = progress.Progress(
        "{task.description}",
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        "left:",
        progress.TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    bars.start()
    return bars
