"""What a person sees: lines, tables and progress, in colour on a terminal, plain text elsewhere.

rich draws what a terminal shows. It takes 0.03 s to import, and is not where no terminal is.
"""

import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Self

import click

from mocap_calib.errors import count

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID
    from rich.table import Table as RichTable

_NUMBER = tuple("+-0123456789")  # what a number, or the dash in its place, begins with
_BAR_AFTER = 1.0  # seconds before a stage gets a bar
_LINE_AFTER = 30.0  # seconds without a line where stderr is no terminal


@dataclass(frozen=True)
class Table:
    """Rows of cells below a header; alarming: the header of a column that says what is wrong."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    alarming: str = ""


@dataclass(frozen=True)
class Line:
    """A line of text, and the colour in which a terminal shows it (a style of rich)."""

    text: str
    style: str = ""


Shown = Table | Line


def show(*parts: Shown, err: bool) -> None:
    """Write tables and lines to stdout, or to stderr where `err`.

    On a terminal rich wraps cells to its width, and heeds NO_COLOR.
    """
    if not (sys.stderr if err else sys.stdout).isatty():
        for part in parts:
            lines = [part.text] if isinstance(part, Line) else format_table(part.header, part.rows)
            click.echo("\n".join(lines), err=err)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=err, highlight=False)
    for part in parts:
        if isinstance(part, Line):
            console.print(Text(part.text, part.style), soft_wrap=True)
        else:
            console.print(_rich_table(part))


def _rich_table(table: Table) -> "RichTable":
    """Return a table as rich draws it. Names are text, whatever brackets they have."""
    from rich.table import Table as RichTable
    from rich.text import Text

    drawn = RichTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    numeric = _numeric_columns(table.rows, len(table.header))
    for name, is_number in zip(table.header, numeric, strict=True):
        drawn.add_column(
            name.replace(" ", "\n") if is_number else name,  # a unit below leaves room for names
            justify="right" if is_number else "left",
            no_wrap=is_number,
            overflow="fold",
            style="yellow" if name == table.alarming else "",
        )
    for row in table.rows:
        drawn.add_row(*map(Text, row))
    return drawn


def format_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return lines of aligned columns: numbers to the right, all else to the left.

    The first column is never of numbers.
    """
    cells = [tuple(row) for row in rows]
    table = [tuple(header), *cells]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    aligned = [
        str.rjust if number else str.ljust for number in _numeric_columns(cells, len(header))
    ]
    columns = list(zip(aligned, widths, strict=True))
    return [
        "  ".join(
            align(cell, width) for cell, (align, width) in zip(row, columns, strict=True)
        ).rstrip()
        for row in table
    ]


def _numeric_columns(rows: Sequence[Sequence[str]], columns: int) -> list[bool]:
    """Return which columns hold numbers, and dashes where there is none."""
    return [
        index > 0 and all(row[index].startswith(_NUMBER) for row in rows)
        for index in range(columns)
    ]


def format_number(value: float | None, digits: int = 2) -> str:
    """Return a number for a table, a dash where there is none (None or NaN)."""
    return "-" if value is None or value != value else f"{value:.{digits}f}"  # noqa: PLR0124 - NaN


class Reporter:
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
            click.echo(line, err=True)

    def show(self, *parts: Shown) -> None:
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
        if self.terminal:
            self._show_bar()
        elif done < total:
            self._show_line()
        if done >= total:
            self._finish_stage()

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

    def __enter__(self) -> Self:
        self.start = time.monotonic()
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


def _start_bars() -> "Progress":
    """Start bars on stderr."""
    from rich import progress
    from rich.console import Console

    bars = progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TextColumn("left:"),
        progress.TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    bars.start()
    return bars
