"""Spread independent work over threads and processes of this machine.

What is computed never depends on how many there are: blocks are cut by their content alone, put
together in their order, and each runs on one thread. OpenMP and BLAS, whose sums depend on the
number of threads, are held to one.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from functools import cache
from itertools import islice
from typing import TypeVar

from threadpoolctl import threadpool_limits

from mocap_calib.compute.worker import Worker, WorkerEndedError
from mocap_calib.errors import ClusterError

Item = TypeVar("Item")
Result = TypeVar("Result")


def thread_count() -> int:
    """Return the number of processors at hand, or fewer where OMP_NUM_THREADS says so."""
    if hasattr(os, "sched_getaffinity"):
        at_hand = len(os.sched_getaffinity(0))
    else:
        at_hand = os.cpu_count() or 1
    wanted = os.environ.get("OMP_NUM_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return min(at_hand, int(wanted))
    return at_hand


# BLAS and OpenMP have one number of threads for the whole program: only the first who holds them
# sets it (which looks through all libraries, 4 ms), and only the last gives back what it was
_lock = threading.Lock()
_holders: list[None] = []
_limits = ExitStack()


@contextmanager
def single_threaded_libraries() -> Iterator[None]:
    """Hold BLAS and OpenMP to one thread each: the threads of this module are enough.

    Also the decorator of what Python users call: their arrays are small, and threads that wait for
    each other take twenty times the processor and make sums depend on the machine.
    """
    with _lock:
        if not _holders:
            _limits.enter_context(threadpool_limits(1))
        _holders.append(None)
    try:
        yield
    finally:
        with _lock:
            _holders.pop()
            if not _holders:
                _limits.close()


def map_in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `function` of every item in order, computed on threads.

    A few items at a time are under way, and no more are taken from `items`. What such a thread
    spreads in its turn it does itself: the others are busy.
    """
    count = thread_count()
    if count == 1 or getattr(_THREAD, "of_the_pool", False):
        yield from map(function, items)
        return
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(_pool(count).submit(function, item))
            if len(waiting) > 2 * count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for call in waiting:
            call.cancel()


def do_in_threads(function: Callable[[Item], None], items: Iterable[Item]) -> None:
    """Call `function` with every item, on the threads of `map_in_threads`."""
    for _ in map_in_threads(function, items):
        pass


_THREAD = threading.local()


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Return the threads of this process, which stay: an adjustment asks for them every step."""

    def mark() -> None:
        _THREAD.of_the_pool = True

    return ThreadPoolExecutor(count, initializer=mark)


if hasattr(os, "register_at_fork"):  # a child has no threads but its own
    os.register_at_fork(after_in_child=_pool.cache_clear)


class Processes:
    """Implements `types.Mapper` by processes of this machine, each of which uses one thread.

    threads: how many pieces of work can be done at a time. They end with `close`.
    """

    def __init__(self, count: int) -> None:
        self.threads = count
        self._workers = [Worker() for _ in range(count)]
        self._idle = list(self._workers)
        self._pool = ThreadPoolExecutor(count)  # a thread waits for the answer of each process

    def __call__(
        self, function: Callable[[Item], Result], items: Iterable[Item], /
    ) -> Iterator[Result]:
        """Yield `function` of every item as it is done. Raises as a call of `completed` does."""
        for _, result in self.completed(function, items):
            yield result()

    def completed(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[tuple[Item, Callable[[], Result]]]:
        """Yield each item when it is done, with a call that returns `function` of it.

        The call raises what the function raised, and ClusterError where its process was killed.
        No more items are taken than keep the processes busy.
        """
        waiting = iter(items)
        under_way: dict[Future[Result], Item] = {}

        def refill() -> None:
            # one more than there are processes, so that none waits while the next item is made
            for item in islice(waiting, self.threads + 1 - len(under_way)):
                call = self._pool.submit(self._call_idle_worker, function, item)
                under_way[call] = item

        refill()
        while under_way:
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for call in done:
                item = under_way.pop(call)
                refill()
                yield item, call.result

    def _call_idle_worker(self, function: Callable[[Item], Result], item: Item) -> Result:
        """Return `function` of an item, computed by a process that has nothing else to do."""
        worker = self._idle.pop()
        try:
            return worker.call(function, item)
        except WorkerEndedError as error:
            raise ClusterError(
                "",
                "a process that survives the work",
                f"it ended by {error}",
                "give it more memory, or do less at a time",
            ) from None
        finally:
            self._idle.append(worker)

    def close(self) -> None:
        """End the processes at once, whatever they do."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            worker.kill()
        self._pool.shutdown()  # the calls under way fail now, and no process starts again
        for worker in self._workers:
            worker.end()
