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
from corruption import damaged
from golden.cases import written
from golden.command import call

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


def _by_command(files: Mapping[str, bytes], *commands: tuple[object, ...]) -> Kind:
    """Return a kind of files that commands read, in their folder."""
    return Kind(
        files,
        lambda folder: [partial(command, *words, folder=folder) for words in commands],
    )


RUN = ("run", "nothing", "-o", "new", "--config", "recording.yaml")


def _options(content: bytes, results: Path) -> Kind:
    """What `run --config` reads, which names landmarks, cameras, clocks and lengths."""
    cameras = {"calibration.toml": (results / "calibration.toml").read_bytes()}
    return _by_command({"recording.yaml": content, "landmarks.csv": LANDMARKS, **cameras}, RUN)


def _names(_: Path) -> Kind:
    return _by_command(
        {"names.yaml": b"aliases:\n  schnauze: nose\n  linkes_ohr: left_ear\n"}
        | {f"{name}.csv": b"frame,keypoint,x,y\n0,schnauze,1,2\n" for name in "ab"},
        ("inspect", "a.csv", "b.csv", "--skeleton", "names.yaml", "--image-size", "8x8"),
    )


def _skeleton(_: Path) -> Kind:
    """What `train` reads of a skeleton, before the poses that are not there."""
    skeleton = (PACKAGE / "skeletons" / "rodent.yaml").read_bytes()
    words = ("train", "nothing.npz", "--skeleton", "rodent.yaml", "-o", "new.safetensors")
    return _by_command({"rodent.yaml": skeleton}, words)


def _weights(_: Path) -> Kind:
    weights = (PACKAGE / "weights" / "people.safetensors").read_bytes()

    def read(folder: Path) -> None:
        paths = [folder / f"{name}.csv" for name in "ab"]
        mc.read_recording(paths, model=folder / "own.safetensors", image_size=(8, 8))

    tables = {
        f"{name}.csv": b"frame,keypoint,x,y\n0,nose,%d,2\n" % k for k, name in enumerate("ab")
    }
    return Kind(
        {"own.safetensors": weights, **tables},
        lambda folder: [partial(refused, partial(read, folder))],
    )


def _stages(results: Path) -> Kind:
    """What the commands of single stages read: pairs and matches."""
    scene = written(results / "scene")
    keypoints = {path: content for path, content in scene.items() if path.startswith("keypoints")}
    names = ("matches.csv", "pairs.json", "cameras.yaml")
    return _by_command(
        {name: (results / name).read_bytes() for name in names} | keypoints,
        ("average", "pairs.json", "-o", "new.yaml", "-q"),
        ("triangulate", "keypoints", "--rig", "cameras.yaml", "--matches", "matches.csv")
        + ("-o", "new.h5", "-q"),
    )


def _results(results: Path) -> Kind:
    """What a run wrote, for `report`, `overlay` and `convert`."""
    names = ("run.json", "cameras.yaml", "matches.csv", "poses3d.h5")
    return _by_command(
        {f"out/{name}": (results / name).read_bytes() for name in names},
        ("report", "out", "-o", "new.html", "-q"),
        ("convert", "out", "new.npz", "-q"),
    )


LANDMARKS = b"""name,x,y,z,camera,u,v
corner,0,0,0,cam1,100.5,200
corner,0,0,0,cam2,300,220
door,2.5,0,1.9,cam1,500,80
"""
KNOWN = b"""# what is known of a recording
cameras: calibration.toml
views: left,right
image-size: 1920x1080
layout: coco_17
camera-regex: cam(?P<camera>[0-9]+)
frame-offset: [cam1:-3, cam2:5]
crop-offset: cam1:10,20.5
fps:
  - 60
  - cam2:29.97
sync: check
rotated: cam1:90
resized: cam2:0.5
moved: cam1:120
mirrored: cam1
sides: [cam1, cam2]
refine: focal
focal-uncertainty: 5%
individuals: 3
seed: 1
world: floor
height:
  - 0=1.75+-0.01
  - 1.8
length: left_hip-left_knee=0.42+-0.01
camera-distance: cam1-cam2=3.1+-0.02
forward: left_hip-nose
smooth: bones
strict: true
"""
ALIGNED = b"""# a scene whose landmarks are known
cameras: calibration.toml
align: landmarks.csv
mirrored: [cam1, cam2]
mend: auto
pairs: chosen
focal-per-camera: true
refine: focal
"""

# name: what makes it, of the folder that `make_results` filled
KINDS: dict[str, Callable[[Path], Kind]] = {
    **{
        f"{kind} {path.name}": partial(_corpus, kind, path.name)
        for kind in TARGETS
        for path in sorted((CORPUS / kind).iterdir())
    },
    "options": partial(_options, KNOWN),
    "options of a scene": partial(_options, ALIGNED),
    "names of joints": _names,
    "skeleton": _skeleton,
    "stages": _stages,
    "weights": _weights,
    "results": _results,
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
