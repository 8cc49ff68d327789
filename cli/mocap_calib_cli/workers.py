"""Where work is done: in this process, in processes of this machine, or on a cluster."""

import logging
import signal
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from mocap_calib.errors import ClusterError, argument
from mocap_calib_cli.screen import Reporter

if TYPE_CHECKING:
    from mocap_calib.compute.cluster import Cluster
    from mocap_calib.compute.parallel import Processes


@contextmanager
def open_workers(
    reporter: Reporter, *, scheduler: str | None = None, processes: int = 1
) -> "Iterator[Cluster | Processes | None]":
    """Start the workers of a scheduler, or so many processes, and end them with the block.

    None where the work is done in this process. Batch systems end a job with SIGTERM: from here
    on the program removes what is half written when it comes.

    scheduler: address of a Dask scheduler, instead of processes.

    Raises ClusterError where there are no such workers.
    """
    signal.signal(signal.SIGTERM, _exit_on_signal)
    if scheduler is None and processes == 1:
        yield None
        return
    from mocap_calib.compute import parallel

    given = _connect(scheduler) if scheduler else closing(parallel.Processes(processes))
    with given as workers:
        place = f" by the workers of {scheduler}" if scheduler else ""
        reporter.say(f"{workers.threads} at a time{place}")
        yield workers


def _connect(scheduler: str) -> "AbstractContextManager[Cluster]":
    """Return the workers of a scheduler; the package for it is an extra."""
    try:
        from mocap_calib.compute import cluster
    except ModuleNotFoundError as error:
        raise ClusterError(
            argument("scheduler"),
            f"the package {error.name}",
            "none",
            "pip install 'mocap-calib[distributed]'",
        ) from None
    # what it has to say comes as an error, in one line; its import has set these levels itself
    for logger in ("distributed", "distributed.client"):
        logging.getLogger(logger).setLevel(logging.CRITICAL)
    return cluster.cluster(scheduler)


def _exit_on_signal(number: int, _: FrameType | None) -> None:
    """End the program in order, with the status that shells give a signal."""
    sys.exit(128 + number)
