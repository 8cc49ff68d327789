"""Wall time by stage."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """Wall time by stage: `with clock("lift"): ...` adds to an entry of `seconds`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Take the time of what is done inside the context."""
        start = time.perf_counter()
        yield
        spent = time.perf_counter() - start
        self.seconds[stage] = self.seconds.get(stage, 0.0) + spent

    def continued(self) -> "Clock":
        """Return a clock that goes on from the entries of this one."""
        clock = Clock()
        clock.seconds = dict(self.seconds)
        return clock
