"""Spread work over the machines of a Dask cluster: the one door to dask.distributed, an extra.

A piece of work carries its own data and is sent once, so that a worker that dies takes nothing
along that others need. Results are those of `map` to the last digit where all processors are of
one kind.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import Any, TypeVar

import dask
from dask.typing import Key
from distributed import Client, Future, KilledWorker, as_completed
from distributed.comm.addressing import get_address_host_port
from distributed.comm.core import CommClosedError
from distributed.protocol.pickle import dumps, loads
from distributed.security import Security

from mocap_calib.compute import identify_program
from mocap_calib.errors import ClusterError

T = TypeVar("T")
R = TypeVar("R")

# no warning of pieces of more than 10 MB: each is used once
_LARGE_PIECES = {"distributed.admin.large-graph-warning-threshold": "100 GB"}
_PATIENCE = "10s"  # until a scheduler answers
_GONE = (
    "",
    "a scheduler that answers to the end",
    "it gone",
    "start it again, and then this command: what is finished is kept",
)
# pieces under way at least, so that a growing cluster finds work; else two for each thread
_LEAST_UNDER_WAY = 8


class Cluster:
    """Implements `types.Mapper` by the workers of a Dask cluster."""

    def __init__(self, client: Client) -> None:
        self.client = client

    @property
    def threads(self) -> int:
        """Number of pieces of work that can be done at a time, now."""
        with _answering():
            return sum(self.client.nthreads().values())

    def __call__(self, function: Callable[[T], R], items: Iterable[T], /) -> Iterator[R]:
        """Yield `function` of every item as it is done. Raises ClusterError."""
        for _, result in self.completed(function, items):
            yield result()

    def completed(
        self, function: Callable[[T], R], items: Iterable[T]
    ) -> Iterator[tuple[T, Callable[[], R]]]:
        """Yield each item when it is done, with a call that returns `function` of it.

        The call raises what the function raised, and ClusterError when the item has killed its
        workers. Only so many items are taken that no worker waits. Raises ClusterError when the
        scheduler is gone.
        """
        waiting = iter(items)
        under_way: dict[Key, T] = {}
        queue = as_completed(loop=self.client.loop)

        def refill() -> None:
            wanted = max(_LEAST_UNDER_WAY, 2 * self.threads) - len(under_way)
            for item in islice(waiting, max(0, wanted)):
                future = self._submit(function, item)
                under_way[future.key] = item
                queue.add(future)

        refill()
        for future in queue:
            if future.cancelled():
                raise ClusterError(*_GONE)
            yield under_way.pop(future.key), partial(_result, future)
            refill()

    def _submit(self, function: Callable[[T], R], item: T) -> "Future[R]":
        # packed here: a worker of other code could fail to unpack it before it can say why
        work = dumps((function, item))
        with _answering():
            return self.client.submit(_compute, identify_program(), work, pure=False)


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Connect to the Dask scheduler at `address` (tcp://..., or tls://...).

    The certificates of tls:// are those of Dask's configuration (DASK_DISTRIBUTED__COMM__TLS__...).

    Raises ClusterError where there is no scheduler, and where a certificate is missing.
    """
    with dask.config.set(_LARGE_PIECES):
        try:
            get_address_host_port(address, strict=True)
        except ValueError as error:
            raise ClusterError(
                "",
                "the address of a Dask scheduler (tcp://HOST:PORT)",
                f"{address} ({error})",
                "it says it when it starts",
            ) from None
        _check_certificate(address)
        try:
            client = Client(address, timeout=_PATIENCE, set_as_default=False)
        except OSError as error:
            raise ClusterError(
                address,
                "a Dask scheduler",
                f"none that answers ({error})",
                "start it with `dask scheduler`",
            ) from None
        with client:
            yield Cluster(client)


def _check_certificate(address: str) -> None:
    """Raise ClusterError where the address asks for TLS and nobody said by which certificate."""
    if address.startswith("tls://") and not Security().get_connection_args("client")["ssl_context"]:
        raise ClusterError(
            address,
            "a certificate for TLS in Dask's configuration",
            "none",
            "set DASK_DISTRIBUTED__COMM__TLS__CA_FILE, ..._CLIENT__CERT and ..._CLIENT__KEY "
            "(docs/many-recordings.md)",
        )


@contextmanager
def _answering() -> Iterator[None]:
    """Turn whatever goes wrong with the connection into ClusterError."""
    try:
        yield
    except OSError:
        raise ClusterError(*_GONE) from None


def _compute(program: str, work: bytes) -> Any:
    """Return, on a worker, the function of the item in `work`.

    Raises ClusterError where the worker is not the program that sent it.
    """
    if program != identify_program():
        raise ClusterError(
            "",
            f"mocap-calib {program} on every worker",
            identify_program(),
            "install the same there",
        )
    function, item = loads(work)
    return function(item)


def _result(future: "Future[R]") -> R:
    try:
        return future.result()
    except KilledWorker as error:
        raise ClusterError(
            "",
            "workers that survive the work",
            f"{error.allowed_failures + 1} killed by the same piece",
            "give them more memory",
        ) from None
    except (CancelledError, CommClosedError):  # gone before the result, or while it is fetched
        raise ClusterError(*_GONE) from None
    except (ModuleNotFoundError, RuntimeError) as error:
        missing = error.__cause__ or error  # the scheduler tells of it in its own words
        if not isinstance(missing, ModuleNotFoundError):
            raise
        raise ClusterError(
            "",
            "the same packages where the scheduler and the workers are as here",
            missing,
            "install mocap-calib there",
        ) from None
