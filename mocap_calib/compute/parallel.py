"""The one place where work is spread over threads and processes. What is computed never depends on how many there are.

Blocks are cut by their content alone and put together in their order, and each runs on one thread: OpenMP and BLAS, whose sums depend
on the number of threads, are held to one.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from typing import TypeVar

from threadpoolctl import threadpool_limits

from mocap_calib.compute.worker import Child

Item = TypeVar("Item")
Result = TypeVar("Result")


def threads() -> int:
    """The processors at hand, or fewer where OMP_NUM_THREADS says so."""
    wanted = os.environ.get("OMP_NUM_THREADS", "")
    at_hand = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return min(at_hand, int(wanted)) if wanted.isdigit() and int(wanted) else at_hand


@contextmanager
def single_threaded_libraries() -> Iterator[None]:
    """BLAS and OpenMP on one thread each: ours are enough."""
    with threadpool_limits(1):
        yield


def in_order(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """The results for all items, in their order, as they come; a few at a time are under way, and no more items are taken."""
    count = threads()
    if count == 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(count) as pool:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > 2 * count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def in_processes(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """As `in_order`, in other processes, for work on small arrays, which holds the interpreter. All that goes and comes is pickled."""
    idle: SimpleQueue[Child] = SimpleQueue()

    def elsewhere(item: Item) -> Result:
        child = idle.get()
        try:
            return child.ask(function, item)
        finally:
            idle.put(child)

    count = threads()
    if count == 1:
        yield from map(function, items)
        return
    children = [Child() for _ in range(count)]
    try:
        for child in children:
            idle.put(child)
        yield from in_order(elsewhere, items)
    finally:
        for child in children:
            child.end()
