"""Every kind of file that the program reads: small files of it, and the readers that meet them.

A reader meets the files in a folder of their own, where one of them is damaged. It reads them, or
refuses in one line, soon and without a flood of memory: `hold(call)` asserts that.
"""

import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conformance import CORPUS, KEYPOINTS, TARGETS
from golden.cases import written
from golden.command import call
from golden.damage import damaged

import mocap_calib as mc

resource = pytest.importorskip("resource", reason="needs POSIX, which counts the peak of memory")
PACKAGE = Path(mc.__file__).parent
SECONDS = 5.0  # of computing for a file of some kilobytes
CLOCK = 120.0  # for what waits, on a busy machine: hangs alone
MEMORY = 1_000_000  # kB that one file may add to the peak
MOST_CHARACTERS = 1500  # of a complaint
Call = Callable[[], str]


@dataclass(frozen=True)
class Kind:
    """Files by their paths in a folder, and the calls that read the folder.

    calls: of the folder; each returns the complaint, "" where the files are read.
    """

    files: Mapping[str, bytes]
    calls: Callable[[Path], list[Call]]


def hold(read: Call) -> str:
    """Return the complaint; the call takes little time and memory, and says one line."""
    begun, peak = _spent(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    said = read()
    assert "\n" not in said, said
    assert len(said) < MOST_CHARACTERS, said
    took = _spent() - begun
    assert (took < (SECONDS, CLOCK)).all(), f"took {took[0]:.1f} s of computing, {took[1]:.1f} s"
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak
    assert grown < MEMORY, f"took {grown} kB"
    return said


def _spent() -> np.ndarray:
    """Return seconds of computing, and by the clock."""
    return np.array([time.process_time(), time.perf_counter()])


def lay_out(kind: Kind, folder: Path) -> None:
    """Write the files of a kind."""
    for path, content in kind.files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)


def try_damaged(kind: Kind, folder: Path, rng: random.Random) -> None:
    """Damage one file of a kind in a folder, and hold its readers to the law."""
    lay_out(kind, folder)
    victim = rng.choice(sorted(kind.files))
    (folder / victim).write_bytes(damaged(kind.files[victim], rng))
    for read in kind.calls(folder):
        hold(read)


def refused(read: Callable[[], object]) -> str:
    """Return what a reader of the library refuses with, "" where it reads."""
    try:
        read()
    except mc.MocapCalibError as error:
        return str(error) or "nothing\n"
    return ""


def command(*words: object, folder: Path) -> str:
    """Return what a command refuses with, "" where it does its work; warnings do not count."""
    done = call(*words, folder=folder)
    lines = [line for line in done.stderr if line.startswith(("mocap-calib: ", "Error: "))]
    assert len(lines) <= 1
    assert lines or done.status == 0 or done.stdout, "`inspect` prints what it finds"
    return "".join(lines)


def _corpus(kind: str, name: str, _: Path) -> Kind:
    files = written(CORPUS / kind / name)
    options = mc.ReadOptions(**(KEYPOINTS[name].options if kind == "keypoints" else {}))

    def keypoints(folder: Path) -> None:
        for view in mc.read_keypoints(sorted(folder.iterdir()), None, options):
            assert np.isfinite(view.confidence).all()
            assert (np.diff(view.frames) > 0).all()

    def calls(folder: Path) -> list[Call]:
        path = folder if len(files) > 1 else folder / min(files)
        named = name if name in TARGETS[kind] else None
        reads = {
            "keypoints": [partial(keypoints, folder)],
            "cameras": [partial(mc.read_cameras, path), partial(mc.read_rig, path, named)],
            "poses": [
                partial(mc.read_poses, folder / each, form)
                for each in files
                for form in (None, name)
            ],
        }
        return [partial(refused, read) for read in reads[kind]]

    return Kind(files, calls)


def _weights(_: Path) -> Kind:
    files = {f"{name}.csv": b"frame,keypoint,x,y\n0,nose,%d,2\n" % k for k, name in enumerate("ab")}
    files["own.safetensors"] = (PACKAGE / "weights" / "people.safetensors").read_bytes()

    def read(folder: Path) -> None:
        paths = [folder / f"{name}.csv" for name in "ab"]
        mc.read_recording(paths, model=folder / "own.safetensors", image_size=(8, 8))

    return Kind(files, lambda folder: [partial(refused, partial(read, folder))])


TRIANGULATE = ("triangulate", "keypoints", "--rig", "cameras.yaml", "--matches", "matches.csv")
CONFIG = ("run", "nothing", "-o", "new", "--config", "recording.yaml")
# what reads files together, in their folder
COMMANDS: dict[str, tuple[tuple[object, ...], ...]] = {
    "commands/recording": (CONFIG,),
    "commands/scene": (CONFIG,),
    "commands/names": (
        ("inspect", "a.csv", "b.csv", "--skeleton", "names.yaml", "--image-size", "8x8"),
    ),
    "skeleton": (("train", "nothing.npz", "--skeleton", "rodent.yaml", "-o", "new.safetensors"),),
    "stages": (
        ("average", "pairs.json", "-o", "new.yaml", "-q"),
        (*TRIANGULATE, "-o", "new.h5", "-q"),
    ),
    "results": (("report", ".", "-o", "new.html", "-q"), ("convert", ".", "new.npz", "-q")),
}
# of a run, what the commands of single stages read, and `report` and `convert`
STAGES = ("matches.csv", "pairs.json", "cameras.yaml")
RESULTS = ("run.json", "cameras.yaml", "matches.csv", "poses3d.h5")


def _commanded(name: str, results: Path) -> Kind:
    if name.startswith("commands/"):
        files = written(CORPUS / name) | written(CORPUS / "cameras" / "anipose")
    elif name == "skeleton":
        files = {"rodent.yaml": (PACKAGE / "skeletons" / "rodent.yaml").read_bytes()}
    else:
        kept = RESULTS if name == "results" else STAGES
        files = {each: (results / each).read_bytes() for each in kept}
        scene = written(results / "scene" / "keypoints") if name == "stages" else {}
        files |= {f"keypoints/{path}": content for path, content in scene.items()}
    return Kind(
        files,
        lambda folder: [partial(command, *words, folder=folder) for words in COMMANDS[name]],
    )


# name: what makes it, of the folder that `make_results` filled
KINDS: dict[str, Callable[[Path], Kind]] = {
    **{
        f"{kind} {path.name}": partial(_corpus, kind, path.name)
        for kind in TARGETS
        for path in sorted((CORPUS / kind).iterdir())
    },
    **{name: partial(_commanded, name) for name in COMMANDS},
    "weights": _weights,
}


def make_results(folder: Path) -> Path:
    """Fill a folder with a small scene, what `run` makes of it, and the file of `pairwise`."""
    words = ("--cameras", 3, "--people", 2, "--frames", 30, "--seed", 1)
    known = ("scene/keypoints", "--cameras", "scene/intrinsics.toml", "-q", "-o")
    for each in (
        ("simulate", "-o", "scene", *words),
        ("run", *known, ".", "--no-report"),
        ("pairwise", *known, "pairs.json"),
    ):
        assert call(*each, folder=folder).status == 0
    return folder
