"""Tables and lines that say something: in colour on a terminal, plain text elsewhere."""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable

_NUMBER = tuple("+-0123456789")  # what a number, or the dash in its place, begins with


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


def show(*parts: Shown, err: bool, console: "Console | None" = None) -> None:
    """Write tables and lines to stdout, or to stderr where `err`.

    console: where to; None: rich's where the stream is a terminal, plain text where it is not.
        rich wraps cells to the width of the terminal, and heeds NO_COLOR.
    """
    if console is None and not (sys.stderr if err else sys.stdout).isatty():
        for part in parts:
            lines = [part.text] if isinstance(part, Line) else format_table(part.header, part.rows)
            click.echo("\n".join(lines), err=err)
        return
    from rich.console import Console  # here, because it takes a while
    from rich.text import Text

    console = console or Console(stderr=err, highlight=False)
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
    for index, name in enumerate(table.header):
        is_number = numeric[index]
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
    numeric = _numeric_columns(cells, len(header))
    table = [tuple(header), *cells]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if is_number else cell.ljust(width)
            for cell, width, is_number in zip(row, widths, numeric, strict=True)
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
