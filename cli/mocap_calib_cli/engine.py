"""Where work is done: here, in processes of this machine, or by the workers of a cluster."""

import logging
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from mocap_calib.errors import ClusterError
from mocap_calib_cli.progress import Reporter

if TYPE_CHECKING:
    from mocap_calib.compute.cluster import Cluster


@contextmanager
def engine(
    reporter: Reporter, *, scheduler: str | None = None, jobs: int = 1
) -> "Iterator[Cluster | None]":
    """The workers of the scheduler, or `jobs` processes; None where work is done here. Raises ClusterError.

    From here on SIGTERM, with which batch systems end a job, lets the program take away what is half written.
    """
    signal.signal(signal.SIGTERM, _terminate)
    if scheduler is None and jobs == 1:
        yield None
        return
    try:
        from mocap_calib.compute.cluster import cluster, processes
    except ModuleNotFoundError as error:
        raise ClusterError(
            f"expected the package {error.name}, found none; pip install 'mocap-calib[distributed]'"
        ) from None
    logging.getLogger("distributed.client").setLevel(
        logging.CRITICAL
    )  # what it has to say comes as an error, in one line
    with cluster(scheduler) if scheduler else processes(jobs) as there:
        reporter.say(
            f"{there.threads} at a time" + (f" by the workers of {scheduler}" if scheduler else "")
        )
        yield there


def _terminate(number: int, _: FrameType | None) -> None:
    sys.exit(128 + number)
