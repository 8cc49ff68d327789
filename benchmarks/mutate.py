"""Change the program in small ways, one at a time, and see whether its tests notice.

    .venv/bin/python benchmarks/mutate.py              # 200 mutations, chosen by seed 0
    .venv/bin/python benchmarks/mutate.py --number 100 --seed 1 --package geometry

As many mutations are drawn of each package: a comparison turned, + made -, a constant changed, a
condition negated, a line left out, arguments exchanged (`mutations.py`). It works on a copy of the
tree. First each file of tests runs once as it is, which tells the lines that each test runs. A
mutation is then tried with the tests that run its line and with all others of their files, the
quickest first, until one fails; where none runs it, with those of its module, or those of the
command: readers of files and the command run in processes of their own. Of tests that would take
longer than `--seconds` together, the slow ones are left out. Mutations that never end are noticed
by the processor time that they take.

What was tried is kept in a file (`--log`), a line of JSON each, and not tried again: a run that
was stopped goes on. Survivors that change nothing that a user sees stand in
`mutations_survived.toml`, each with the reason; the others are printed with the tests that tried.
Needs an operating system that can fork.
"""

import argparse
import compileall
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path

import pytest
from lines_of_tests import LinesOfTests, Selected, Tests
from mutation_report import place, read_log, read_reasons, report
from mutations import Mutation, find_mutations

ROOT = Path(__file__).parents[1]
PACKAGES = (
    *("geometry", "pairs", "rig", "adjust", "identities", "clocks", "verdict", "faults", "lift"),
    "io",
)
# folders of tests/, and patterns of files
COMMAND = ("cli/test_cli*.py",)
TESTS = (*PACKAGES, "recording", "synthetic", "poses", "world", "compute", "golden", "oracles")
TESTS += ("test_front_door.py", "test_pipeline.py", "test_report.py", "test_types.py", *COMMAND)
# tests of other packages that hold some modules of these, too
BESIDE = {"geometry": ("io/test_cameras.py", "oracles"), "io": ("world", "golden")}
PRELOADED = ("cv2", "h5netcdf", "h5py", "hypothesis.extra.numpy", "numba", "pdb", "pycolmap")
PRELOADED += ("safetensors.torch", "scipy.ndimage", "scipy.optimize", "torch", "xarray", "yaml")
LOADED = "ignore::pytest.PytestAssertRewriteWarning"  # what pytest says of these
NONE = 5  # status of pytest where no test is selected
BROKEN = 70  # status of a process that could not run the tests
FIRST = 20  # tests, which notice most
SLOWER = 4  # than in the run that was timed: longer, and a mutation is taken to never end
WAITING = 4  # times as long by the clock
MEMORY = 5_000_000_000  # bytes of a process; COLMAP fills all there is where nothing stops it


def main() -> None:
    """Markdown on stdout, progress on stderr."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--number", type=int, default=200, help="of mutations (default 200)")
    parser.add_argument("--seed", type=int, default=0, help="of their choice (default 0)")
    parser.add_argument("--package", choices=PACKAGES, help="of these mutations, those of one")
    parser.add_argument("--jobs", type=int, default=1, help="at a time (default 1)")
    parser.add_argument("--seconds", type=float, default=60, help="of tests for each (default 60)")
    parser.add_argument("--own", action="store_true", help="tests of the mutated package alone")
    parser.add_argument("--slow", action="store_true", help="with the tests that are marked slow")
    parser.add_argument("--log", type=Path, default=ROOT / "runs" / "mutations.jsonl")
    parser.add_argument(
        "--again", action="store_true", help="try unexplained survivors of the log again"
    )
    options = parser.parse_args()
    chosen = choose(PACKAGES, options.number, random.Random(options.seed))
    chosen = [mutation for mutation in chosen if mutation.package in (options.package or PACKAGES)]
    options.log.parent.mkdir(parents=True, exist_ok=True)
    os.environ["OMP_NUM_THREADS"] = "1"  # threads of libraries do not survive a fork
    for name in PRELOADED:
        __import__(name)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # pycolmap has set its own
    with tempfile.TemporaryDirectory() as work:
        try_all(chosen, Path(work), options)
    print(report(chosen, read_log(options.log)))


def choose(packages: tuple[str, ...], number: int, rng: random.Random) -> list[Mutation]:
    """Return as many mutations of each package, in an order in which packages take turns."""
    drawn = []
    for package in packages:
        files = sorted((ROOT / "mocap_calib" / package).rglob("*.py"))
        found = [m for file in files for m in find_mutations(ROOT, file.relative_to(ROOT))]
        drawn.append(rng.sample(found, min(-(-number // len(packages)), len(found))))
    longest = max(map(len, drawn))
    turns = [some[k] for k in range(longest) for some in drawn if k < len(some)]
    return turns[:number]


def copy_tree(target: Path) -> Path:
    """Copy what git knows of, and what is new."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True)
    for name in names.stdout.splitlines():
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
    for name in ("mocap_calib", "cli"):  # mutations write no compiled files
        compileall.compile_dir(target / name, quiet=2)
    for kernel in (ROOT / "mocap_calib").rglob("__pycache__/*.nb[ci]"):
        shutil.copy2(kernel, target / kernel.relative_to(ROOT))
    return target


# --- tests


def try_all(chosen: list[Mutation], work: Path, options: argparse.Namespace) -> None:
    """Try what the log does not have, and add it there."""
    known = read_log(options.log)
    if options.again:
        known = {name: entry for name, entry in known.items() if entry["killed"]}
    missing = [mutation for mutation in chosen if mutation.name not in known]
    if options.again:
        missing = [mutation for mutation in missing if place(mutation) not in read_reasons()]
    if not missing:
        return
    copies = [copy_tree(work / f"tree{k}") for k in range(options.jobs)]
    own = {mutation.package for mutation in missing}
    names = tuple(sorted(own | {name for each in own for name in BESIDE.get(each, ())}))
    names = names if options.own else TESTS
    tests = learn_tests(copies[0], names, options.log.with_suffix(".tests.json"), slow=options.slow)
    jobs = []
    try:
        for k, copy in enumerate(copies):
            some = missing[k :: len(copies)]
            jobs.append(fork(partial(try_some, some, copy, tests, options)))
        for child in jobs:
            os.waitpid(child, 0)
            jobs[jobs.index(child)] = 0
    finally:
        for child in filter(None, jobs):
            os.kill(child, signal.SIGTERM)
            os.waitpid(child, 0)


def try_some(some: list[Mutation], copy: Path, tests: Tests, options: argparse.Namespace) -> int:
    """Try mutations one after the other."""
    for k, mutation in enumerate(some, 1):
        entry = asdict(mutation) | try_one(mutation, copy, tests, seconds=options.seconds)
        with open(options.log, "a", encoding="utf-8", newline="\n") as log:
            log.write(json.dumps({"name": mutation.name, **entry}) + "\n")
        word = entry["killed"] or "SURVIVED"
        print(f"{k}/{len(some)} {mutation.describe()}: {word}", file=sys.stderr, flush=True)
    return 0


def learn_tests(copy: Path, names: tuple[str, ...], kept: Path, *, slow: bool) -> Tests:
    """Run every file of tests as it is, each in a process of its own, and see what it calls.

    What an earlier run learned of a file is in `kept`; that holds as long as the program and the
    file are the same. names: of folders and files of tests. slow: also tests that are marked so.
    """
    known = json.loads(kept.read_text("utf-8")) if kept.exists() else {}
    program = sorted([*(copy / "mocap_calib").rglob("*.py"), *(copy / "tests").glob("[!t]*.py")])
    learned = {}
    for file in sorted(tests_of(copy, names)):
        content = b"".join(path.read_bytes() for path in [*program, file])
        marks = ["not slow"] + ["slow"] * (slow and b"mark.slow" in file.read_bytes())
        for mark in marks:
            key = hashlib.sha256(content + mark.encode()).hexdigest()
            if key not in known:
                known[key] = learn_file(copy, file, mark)
                kept.write_text(json.dumps(known), encoding="utf-8", newline="\n")
            learned[key] = known[key]
    if not any(learned.values()):
        raise SystemExit("expected tests that pass before anything is changed, found none")
    otherwise = tuple(str(file.relative_to(copy)) for file in tests_of(copy, COMMAND))
    return Tests([found for found in learned.values() if found], otherwise)


def tests_of(copy: Path, names: tuple[str, ...]) -> Iterator[Path]:
    """Return the files of the tests that are run."""
    for name in names:
        folder = copy / "tests" / name
        yield from folder.rglob("test_*.py") if folder.is_dir() else (copy / "tests").glob(name)


def learn_file(copy: Path, file: Path, mark: str) -> dict:
    """Return what the tests of a file call; nothing where one fails before any change."""
    name, found, start = str(file.relative_to(copy)), copy / "calls.json", time.monotonic()
    which = [name, "-m", mark]
    for here in (True, False):  # some tests are of processes that readers end
        plugin = partial(LinesOfTests, copy, found, here=here)
        status = in_process(copy, plugin, which, seconds=900, compiled=True)
        if status in (0, NONE):
            break
    took = f"{time.monotonic() - start:.0f} s"
    reason = "no such tests" if status == NONE else "fails as it is, and is left out"
    word = reason if status else took
    print(f"{name}, {mark}: {word}", file=sys.stderr, flush=True)
    return {} if status else json.loads(found.read_text("utf-8"))


def try_one(mutation: Mutation, copy: Path, tests: Tests, *, seconds: float) -> dict[str, object]:
    """Return by what the mutation was noticed, "" = not, and how many tests tried."""
    end = mutation.line + mutation.before.count("\n")
    lines = range(min(mutation.first, mutation.line), end + 1)
    os.environ.pop("NUMBA_CACHE_DIR", None)
    is_kernel = "/kernels/" in mutation.path
    if is_kernel:  # what is compiled of it is not kept for the others
        os.environ["NUMBA_CACHE_DIR"] = str(copy / "kernels")
    names, left_out = tests.of_lines(mutation.path, lines, seconds=seconds)
    if not names:
        return {"killed": "", "tests": 0, "left_out": left_out}
    file, failed = copy / mutation.path, copy / "failed.txt"
    original = file.read_bytes()
    stat = file.stat()
    failed.unlink(missing_ok=True)
    try:
        file.write_bytes(mutation.apply(original))
        for some in (names[:FIRST], names[FIRST:]):  # files of tests take long to collect
            expected = sum(tests.seconds[name] for name in some)
            limit = (120 if is_kernel else 30) + SLOWER * expected  # with compiling
            files = sorted({name.split("::")[0] for name in some})
            plugin = partial(Selected, some, failed)
            status = in_process(copy, plugin, files, seconds=limit) if files else 0
            if status:
                break
    finally:
        file.write_bytes(original)
        os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    killed = ""
    if status:
        killed = failed.read_text("utf-8") if failed.exists() else f"status {status}"
    return {"killed": killed, "tests": len(names), "left_out": left_out}


def in_process(
    copy: Path,
    plugin: Callable[[], object],
    files: list[str],
    *,
    seconds: float,
    compiled: bool = False,
) -> int:
    """Run tests of the copy in a process of their own; return its status, below 0 = out of time.

    seconds: of the processor. compiled: keep what is compiled, for later processes.
    """
    child = fork(partial(run_tests, copy, plugin, files, seconds=seconds, compiled=compiled))
    end, done = time.monotonic() + WAITING * seconds, 0
    try:
        while time.monotonic() < end:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.05)
        return -1
    finally:
        if not done:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)


def fork(work: Callable[[], int]) -> int:
    """Start a process that does the work and ends with its status; return its number."""
    child = os.fork()
    if not child:
        status = BROKEN
        try:
            os.setsid()
            status = work()
        except BaseException:
            traceback.print_exc()
        finally:  # nothing of the parent's is cleared away by the child
            os._exit(status)
    return child


def run_tests(
    copy: Path,
    plugin: Callable[[], object],
    files: list[str],
    *,
    seconds: float,
    compiled: bool,
) -> int:
    """Run tests in this process, in silence, and return the status."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.chdir(copy)
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):  # of the three; what goes wrong here is said
        os.dup2(silence, stream)
    roots = [str(copy), str(copy / "cli")]
    os.environ["PYTHONPATH"] = os.pathsep.join(roots)
    sys.path[:0] = roots
    # compiled files of mutations must not be taken for those of the files
    sys.dont_write_bytecode = not compiled
    quiet = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", LOADED]
    sys.modules["numba"].config.reload_config()  # the folder of what it compiles
    return int(pytest.main([*quiet, *files], plugins=[plugin()]))


if __name__ == "__main__":
    main()
