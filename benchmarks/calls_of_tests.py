"""Which tests call which functions of the program: plugins of pytest for `mutate.py`."""

import json
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest


class Tests:
    """What is known of the tests: their seconds, and the functions that they call.

    files: of each file of tests what `CallsOfTests` wrote. otherwise: the files for what no test
    calls.
    """

    def __init__(self, files: list[dict[str, Any]], otherwise: tuple[str, ...]) -> None:
        self.otherwise = otherwise
        self.seconds: dict[str, float] = {}
        self.of_file: dict[str, list[str]] = defaultdict(list)
        self.callers: dict[str, set[str]] = defaultdict(set)
        for found in files:
            self._add(found)

    def _add(self, found: dict[str, Any]) -> None:
        self.seconds.update(found["seconds"])
        for name in found["seconds"]:
            self.of_file[name.split("::")[0]].append(name)
        for function, names in found["callers"].items():
            self.callers[function].update(names)

    def of_function(self, path: str, function: str, *, seconds: float) -> tuple[list[str], int]:
        """Return the tests to try, in their order, and how many are left out.

        Those that call the function first (where none does, any of its module), then the others
        of their files, which may look at what the first ones have made; the tests of its package
        before those of others, the quickest first.
        """
        direct = self.callers.get(f"{path}:{function}", set())
        if not direct:  # of the module, or what runs in other processes
            of_module = [key for key in self.callers if key.startswith(f"{path}:")]
            direct = set().union(*(self.callers[key] for key in of_module))
        files = {name.split("::")[0] for name in direct} or set(self.otherwise)
        names = [name for file in files for name in self.of_file[file]]
        own = f"tests/{path.split('/')[1]}/"
        names.sort(
            key=lambda name: (
                name not in direct,
                not name.startswith(own),
                self.seconds[name],
                name,
            )
        )
        kept, spent = [], 0.0
        for name in names:
            if spent + self.seconds[name] <= seconds:
                kept.append(name)
                spent += self.seconds[name]
        return kept, len(names) - len(kept)


class CallsOfTests:
    """Notes what each test calls, and writes it to a file."""

    def __init__(self, root: Path, out: Path) -> None:
        self.root, self.out = f"{root}/", out
        self.called: set[str] = set()
        self.seconds: dict[str, float] = {}
        self.callers: dict[str, list[str]] = defaultdict(list)
        self.keys: dict[Any, str] = {}

    def _note(self, frame: FrameType, _event: str, _argument: object) -> None:
        code = frame.f_code
        key = self.keys.get(code)
        if key is None:
            path = code.co_filename
            ours = path.startswith(f"{self.root}mocap_calib/")
            key = f"{path[len(self.root) :]}:{code.co_qualname}" if ours else ""
            self.keys[code] = key
        if key:
            self.called.add(key)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Watch one test, with what is set up for it."""
        self.called = set()
        threading.settrace(self._note)
        sys.settrace(self._note)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)
            for key in self.called:
                self.callers[key].append(item.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up the seconds of its phases."""
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration

    def pytest_sessionfinish(self) -> None:
        """Write what was found."""
        content = {"seconds": self.seconds, "callers": self.callers}
        self.out.write_text(json.dumps(content), encoding="utf-8", newline="\n")


class Selected:
    """Runs the named tests alone, in the order of the names, and writes which one failed."""

    def __init__(self, names: list[str], failed: Path) -> None:
        self.place = {name: k for k, name in enumerate(names)}
        self.failed = failed

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out the others."""
        items[:] = [item for item in items if item.nodeid in self.place]
        items.sort(key=lambda item: self.place[item.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write the name of the test that noticed."""
        if report.failed:
            self.failed.write_text(report.nodeid, encoding="utf-8", newline="\n")
