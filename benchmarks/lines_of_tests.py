"""Which tests run which lines of the program: plugins of pytest for `mutate.py`."""

import json
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coverage
import pytest


class Tests:
    """What is known of the tests: their seconds, and the lines that they run.

    files: of each file of tests what `LinesOfTests` wrote. otherwise: the files for what no test
    runs.
    """

    def __init__(self, files: list[dict[str, Any]], otherwise: tuple[str, ...]) -> None:
        self.otherwise = otherwise
        self.seconds: dict[str, float] = {}
        self.of_file: dict[str, list[str]] = defaultdict(list)
        self.runners: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
        for found in files:
            self._add(found)

    def _add(self, found: dict[str, Any]) -> None:
        self.seconds.update(found["seconds"])
        names = list(found["seconds"])
        for name in names:
            self.of_file[name.split("::")[0]].append(name)
        for path, lines in found["lines"].items():
            for line, runners in lines.items():
                self.runners[path][int(line)].update(names[k] for k in runners)

    def of_lines(self, path: str, lines: range, *, seconds: float) -> tuple[list[str], int]:
        """Return the tests to try, in their order, and how many are left out.

        lines: from the first of the function to the last of the change. Those that run the change
        come first (where none does, any of its module; of kernels, those that are named so), then
        the others of their files, which may look at what the first ones have made; the tests of
        its package before those of others, the quickest first.
        """
        runners = self.runners.get(path, {})
        direct = next((runners[k] for k in reversed(lines) if runners.get(k)), set())
        if "/kernels/" in path:  # compiled, so that nothing is seen of their lines
            direct = {name for name in self.seconds if "kernel" in name}
        if not direct:  # of the module, or what runs in other processes
            direct = set().union(*runners.values())
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


class LinesOfTests:
    """Notes what each test runs, and writes it to a file.

    here: files are read in the process of the tests, where their readers are seen.
    """

    def __init__(self, root: Path, out: Path, *, here: bool = False) -> None:
        self.root, self.out = root, out
        self.seconds: dict[str, float] = {}
        self.coverage = coverage.Coverage(data_file=None, source=[str(root / "mocap_calib")])
        self.coverage.start()
        if here:
            from mocap_calib.io import crash_guard  # noqa: PLC0415 - that of the copy

            crash_guard.guard = lambda parse, *args, **_limits: parse(*args)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Watch one test, with what is set up for it."""
        self.coverage.switch_context(item.nodeid)
        try:
            return (yield)
        finally:
            self.coverage.switch_context("")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up the seconds of its phases."""
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration

    def pytest_sessionfinish(self) -> None:
        """Write what was found."""
        self.coverage.stop()
        place = {name: k for k, name in enumerate(self.seconds)}
        data = self.coverage.get_data()
        lines = {}
        for path in data.measured_files():
            found = data.contexts_by_lineno(path).items()
            runners = {line: [place[name] for name in names if name] for line, names in found}
            lines[str(Path(path).relative_to(self.root))] = {k: v for k, v in runners.items() if v}
        content = {"seconds": self.seconds, "lines": lines}
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
