"""Spread independent work over threads and processes of this machine.

What is computed never depends on how many there are: blocks are cut by their content alone, put
together in their order, and each runs on one thread. OpenMP and BLAS, whose sums depend on the
number of threads, are held to one.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from typing import TypeVar

from threadpoolctl import threadpool_limits

from mocap_calib.compute.worker import Worker

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


@contextmanager
def single_threaded_libraries() -> Iterator[None]:
    """Hold BLAS and OpenMP to one thread each: the threads of this module are enough."""
    with threadpool_limits(1):
        yield


def map_in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `function` of every item in order, computed on threads.

    A few items at a time are under way, and no more are taken from `items`.
    """
    count = thread_count()
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


def map_in_processes(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `function` of every item in order, computed in other processes.

    For work on small arrays, where threads wait for the interpreter. The function, the items and
    the results are pickled.
    """
    count = thread_count()
    if count == 1:
        yield from map(function, items)
        return
    workers = [Worker() for _ in range(count)]
    idle: SimpleQueue[Worker] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def call_idle_worker(item: Item) -> Result:
        worker = idle.get()
        try:
            return worker.call(function, item)
        finally:
            idle.put(worker)

    try:
        yield from map_in_threads(call_idle_worker, items)
    finally:
        for worker in workers:
            worker.end()
