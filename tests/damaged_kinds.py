"""Every kind of file that the program reads: made files of it, and the readers that meet them.

A reader meets the files in a folder of their own, where one of them is damaged. It reads them, or
raises a complaint in one line, soon and without a flood of memory: `hold(call)` asserts that.
"""

import io
import json
import random
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import numpy as np
import pytest
from corruption import complaint, damaged
from samples2d import SAMPLES, recording, write_sample
from test_formats_cameras import WRITTEN, studio
from test_formats_cameras_foreign import kalibr
from test_formats_poses import HERE, example

import mocap_calib
from mocap_calib.errors import MocapCalibError
from mocap_calib.html_report.page import report_page
from mocap_calib.io.cameras.formats import CAMERA_FORMATS
from mocap_calib.io.cameras.read import load_cameras, make_rig, parse_content
from mocap_calib.io.cameras.source import Source
from mocap_calib.io.cameras.write import format_rig
from mocap_calib.io.file import decode
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.landmarks_csv import read_landmarks
from mocap_calib.io.poses.read import parse_poses
from mocap_calib.io.poses.write import format_poses
from mocap_calib.io.registry import find_format
from mocap_calib.io.results.matches_csv import parse_matches
from mocap_calib.io.results.pairs_json import pairs_from_json
from mocap_calib.job.reports import open_results, read_source
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.overlay.results import read_results
from mocap_calib.recording.joints import load_aliases, load_section, load_skeleton
from mocap_calib.synthetic.body_plan import parse_body
from mocap_calib.training.poses import load_poses
from mocap_calib_cli.commands.run import command as run
from mocap_calib_cli.inputs import calibration_request
from mocap_calib_cli.options import SharedOptions

resource = pytest.importorskip("resource", reason="needs POSIX, which counts the peak of memory")
PACKAGE = Path(mocap_calib.__file__).parent
SECONDS = 5.0  # of computing for a file of some kilobytes
CLOCK = 60.0  # for what waits, on a busy machine; HDF5 is given 3 s of computing by itself
MEMORY = 1_000_000  # kB that one file may add to the peak
MOST_CHARACTERS = 1500  # of a complaint
Call = Callable[[], object]


@dataclass(frozen=True)
class Kind:
    """Files by their paths in a folder, and the calls that read the folder.

    calls: of the folder, the path that is damaged, and a generator.
    """

    files: Mapping[str, bytes]
    calls: Callable[[Path, str, random.Random], list[Call]]


def spent() -> np.ndarray:
    """Seconds of computing, and by the clock."""
    return np.array([time.process_time(), time.perf_counter()])


def hold(call: Call) -> None:
    """The call reads, or refuses in one line, soon and without a flood of memory."""
    begun, peak = spent(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    said = ""
    try:
        call()
    except MocapCalibError as error:
        said = str(error)
        assert said, "a complaint says something"
    except click.ClickException as error:
        said = error.format_message()
    assert "\n" not in said, said
    assert len(said) < MOST_CHARACTERS, said
    took = spent() - begun
    assert (took < (SECONDS, CLOCK)).all(), f"took {took[0]:.1f} s of computing, {took[1]:.1f} s"
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak
    assert grown < MEMORY, f"took {grown} kB"


def naming(path: str, call: Call) -> Call:
    """Return the call, which must begin its complaint with the path of the file."""

    def named() -> None:
        said = complaint(call)
        assert not said or said.startswith(path), said

    return named


def try_damaged(kind: Kind, folder: Path, rng: random.Random) -> None:
    """Damage one file of a kind, hold its readers to the law, and mend it again.

    folder: holds the files of the kind; they are written where they are not there.
    """
    for path, content in kind.files.items():
        if not (folder / path).is_file():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
    victim = rng.choice(sorted(kind.files))
    (folder / victim).write_bytes(damaged(kind.files[victim], rng))
    try:
        for call in kind.calls(folder, victim, rng):
            hold(call)
    finally:
        (folder / victim).write_bytes(kind.files[victim])


def _keypoints(name: str, _: Path) -> Kind:
    form, _, options, most, scores = SAMPLES[name][:5]
    with tempfile.TemporaryDirectory() as scratch:
        write_sample(name, Path(scratch), *recording(most, scores=scores))
        files = _files_of(Path(scratch))

    def calls(folder: Path, _: str, rng: random.Random) -> list[Call]:
        def read() -> None:
            views = read_keypoints(sorted(folder.iterdir()), rng.choice([None, form]), options)
            assert all(np.isfinite(view.confidence).all() for view in views)
            assert all((np.diff(view.frames) > 0).all() for view in views)

        return [read]

    return Kind(files, calls)


def _cameras(name: str, _: Path) -> Kind:
    if name == "kalibr":
        files = {"chain.yaml": json.dumps({"cam0": kalibr(), "cam1": kalibr()}).encode()}
    elif name == "ros":
        files = {"left.yaml": ROS}
    else:
        files = dict(format_rig(studio(name), name, {"seed": 1}).files)
    form = find_format(CAMERA_FORMATS, name)

    def calls(folder: Path, victim: str, _: random.Random) -> list[Call]:
        content = {path: (folder / path).read_bytes() for path in files}
        whole = Source("folder", content, folder=True)
        together = form.folder and len(content) > 1 and form.sniff(whole)
        return [
            lambda: make_rig(parse_content(content[victim], victim), victim),
            naming(victim, lambda: parse_content(content[victim], victim, name)),
            lambda: load_cameras(folder if len(files) > 1 else folder / victim),
            *([lambda: form.read(whole)] if together else []),
        ]

    return Kind(files, calls)


def _poses(name: str, _: Path) -> Kind:
    files = format_poses(example(1), name, Path("x")).files

    def calls(folder: Path, victim: str, _: random.Random) -> list[Call]:
        content = (folder / victim).read_bytes()
        named = naming(victim, lambda: parse_poses(content, victim, name))
        return [lambda: parse_poses(content, victim), named]

    return Kind(files, calls)


def _options(content: bytes, _: Path) -> Kind:
    """What `run --config` reads, which names landmarks, cameras, clocks and lengths."""
    cameras = format_rig(studio("anipose"), "anipose", {"seed": 1}).files
    files = {"recording.yaml": content, "landmarks.csv": LANDMARKS, **cameras}
    return Kind(files, _read_options)


def _read_options(folder: Path, _: str, __: random.Random) -> list[Call]:
    """What `run --config` makes of a file before it reads a recording."""

    def parse() -> None:
        words = [str(folder), "-o", str(folder / "out"), "--config", str(folder / "recording.yaml")]
        params = run.make_context("run", words).params
        known = SharedOptions.__dataclass_fields__
        shared = SharedOptions(**{key: params[key] for key in params if key in known})
        calibration_request(shared, folder / "out")

    return [parse]


def _landmarks(_: Path) -> Kind:
    return Kind(
        {"landmarks.csv": LANDMARKS},
        lambda folder, path, _: [lambda: read_landmarks(folder / path)],
    )


def _skeleton(_: Path) -> Kind:
    return Kind(
        {"rodent.yaml": (PACKAGE / "skeletons" / "rodent.yaml").read_bytes()}, _read_skeleton
    )


def _aliases(_: Path) -> Kind:
    people = load_skeleton("people")
    content = b"aliases:\n  schnauze: nose\n  linkes_ohr: left_ear\n"
    return Kind(
        {"names.yaml": content},
        lambda folder, path, _: [lambda: load_aliases(folder / path, people)],
    )


def _weights(_: Path) -> Kind:
    content = (PACKAGE / "weights" / "quadruped.safetensors").read_bytes()
    return Kind(
        {"own.safetensors": content}, lambda folder, path, _: [lambda: load_lifter(folder / path)]
    )


def _read_skeleton(folder: Path, victim: str, _: random.Random) -> list[Call]:
    path = folder / victim

    def plan() -> None:
        parse_body(load_section(path, "body"), load_skeleton(path))

    return [
        lambda: load_skeleton(path),
        plan,
        lambda: load_section(path, "training"),
    ]


def _poses_to_learn_from(_: Path) -> Kind:
    store = io.BytesIO()
    names = load_skeleton("quadruped").keypoints[:8]
    poses = np.random.default_rng(0).normal(size=(20, len(names), 3))
    np.savez(store, poses3d=poses, clip=np.arange(20) // 5)
    files = {"poses3d.npz": store.getvalue(), "joints.json": json.dumps({"names": names}).encode()}
    return Kind(files, _read_training_poses)


def _read_training_poses(folder: Path, _: str, __: random.Random) -> list[Call]:
    skeleton = load_skeleton("quadruped")
    return [lambda: load_poses(folder, skeleton, "train")]


def _matches(results: Path) -> Kind:
    def calls(folder: Path, path: str, _: random.Random) -> list[Call]:
        return [lambda: parse_matches(decode((folder / path).read_bytes(), path), path)]

    return Kind({"matches.csv": (results / "matches.csv").read_bytes()}, calls)


def _pairs(results: Path) -> Kind:
    def calls(folder: Path, path: str, _: random.Random) -> list[Call]:
        return [lambda: pairs_from_json(decode((folder / path).read_bytes(), path), path)]

    return Kind({"pairs.json": (results / "pairs.json").read_bytes()}, calls)


def _results(results: Path) -> Kind:
    """What a run wrote, for `overlay` and `report`."""
    names = ("run.json", "cameras.yaml", "matches.csv", "poses3d.h5")

    def calls(folder: Path, _: str, __: random.Random) -> list[Call]:
        page = lambda: report_page(read_source(open_results(folder), None))  # noqa: E731
        return [lambda: read_results(folder), page]

    return Kind({name: (results / name).read_bytes() for name in names}, calls)


def _files_of(folder: Path) -> dict[str, bytes]:
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


ROS = b"""header:
  seq: 1
height: 480
width: 640
distortion_model: plumb_bob
d: [0.1, -0.2, 0.0, 0.001, 0.0]
k: [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
"""
LANDMARKS = b"""name,x,y,z,camera,u,v
corner,0,0,0,cam1,100.5,200
corner,0,0,0,cam2,300,220
door,2.5,0,1.9,cam1,500,80
"""
OPTIONS = b"""# what is known of a recording
cameras: calibration.toml
views: left,right
image-size: 1920x1080
layout: coco_17
camera-regex: cam(?P<camera>[0-9]+)
frame-offset:
  - cam1:-3
  - cam2:5
crop-offset: cam1:10,20.5
fps:
  - 60
  - cam2:29.97
sync: check
sync-window: 40
rotated: cam1:90
resized: cam2:0.5
exchanged: cam1,cam2
moved: cam1:120
mirrored: cam1
sides:
  - cam1
  - cam2
mend: none
refine: focal
focal-uncertainty: 5%
focal-per-camera: true
pairs: all
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
views: left,right
align: landmarks.csv
mirrored: [cam1, cam2]
sides: cam2
mend: auto
pairs: chosen
refine: focal
focal-per-camera: true
"""

# name: what makes it, of the folder of results of a run with the file of `pairwise` in it
KINDS: dict[str, Callable[[Path], Kind]] = {
    **{f"keypoints {name}": partial(_keypoints, name) for name in SAMPLES},
    **{f"cameras {name}": partial(_cameras, name) for name in (*WRITTEN, "kalibr", "ros")},
    **{f"poses {name}": partial(_poses, name) for name in HERE},
    "options": partial(_options, OPTIONS),
    "options of a scene": partial(_options, ALIGNED),
    "landmarks": _landmarks,
    "skeleton": _skeleton,
    "names of joints": _aliases,
    "weights": _weights,
    "poses to learn from": _poses_to_learn_from,
    "matches": _matches,
    "pairs": _pairs,
    "results": _results,
}
