"""What a run that is interrupted leaves, and how it goes on."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap_calib.errors import count
from mocap_calib.job.results import UNFINISHED
from mocap_calib_cli.progress import Reporter


@contextmanager
def say_how_to_go_on(reporter: Reporter, output: Path) -> Iterator[None]:
    """Say on Ctrl-C what of a run is kept in the folder of its results, if anything is."""
    try:
        yield
    except KeyboardInterrupt:
        kept = len(list((output / UNFINISHED).rglob("*.json")))
        if kept:
            pairs = count(kept, "pair")
            reporter.warn(
                f"{pairs} of cameras kept in {output / UNFINISHED}: "
                "the same command goes on from there"
            )
        raise
