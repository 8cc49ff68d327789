"""Commands that are refused: wrong options, files that do not fit, files of another kind.

They run in a folder that `lay_out` makes: `scene` is a small simulated recording of three cameras,
`out` what `run` made of it.
"""

import json
import shutil
from pathlib import Path
from typing import Any

from conformance import CORPUS
from golden.command import call

RUN = ("run", "scene/keypoints", "--cameras", "scene/intrinsics.toml", "-o", "new")
BARE = ("run", "scene/keypoints", "-o", "new")
CONVERT = ("convert", "out/cameras.yaml", "new")
USAGE = ("Usage: ", "Try 'mocap-calib ")
REFUSALS: dict[str, tuple[str, ...]] = {
    # the command line
    "no such command": ("calibrate", "scene"),
    "no such option": (*RUN, "--camera", "x"),
    "no output": ("run", "scene/keypoints"),
    "no keypoints": ("run", "-o", "new"),
    "a file that is not there": ("run", "nothing.csv", "-o", "new"),
    "intrinsics that are not there": (*BARE, "--cameras", "nothing.toml"),
    "a rate of zero": (*RUN, "--fps", "0"),
    "a negative seed": (*RUN, "--seed", "-1"),
    "a size without a height": (*RUN, "--image-size", "640"),
    "a size of zero": (*RUN, "--image-size", "0x480"),
    "a rotation by 45 degrees": (*RUN, "--rotated", "cam1:45"),
    "an offset that is no number": (*RUN, "--frame-offset", "cam1:few"),
    "a layout that is none": (*RUN, "--layout", "coco17"),
    "a regular expression that is none": (*RUN, "--camera-regex", "cam("),
    "a height that is none": (*RUN, "--height", "tall"),
    "a length without a value": (*RUN, "--length", "nose-left_hip"),
    "a refinement that is none": (*RUN, "--refine", "lens"),
    "a model that is none": (*RUN, "--model", "peple"),
    # what does not fit
    "an offset of no camera": (*RUN, "--frame-offset", "left:5"),
    "a mirrored camera that is none": (*RUN, "--mirrored", "left"),
    "exchanged cameras that are none": (*RUN, "--exchanged", "cam1,left"),
    "one camera": (
        *("run", "scene/keypoints/cam1.json", "--cameras", "scene/intrinsics.toml"),
        *("-o", "new"),
    ),
    "one name for two files": (
        *("run", "a=scene/keypoints/cam1.json", "a=scene/keypoints/cam2.json", "-o", "new"),
    ),
    "one file under two names": ("run", "twice", "--cameras", "scene/intrinsics.toml", "-o", "new"),
    "a camera without intrinsics": (
        *("run", "left=scene/keypoints/cam1.json", "scene/keypoints/cam2.json"),
        *("--cameras", "scene/intrinsics.toml", "-o", "new"),
    ),
    "images of another size than is stated": (
        *("run", "half", "--cameras", "scene/intrinsics.toml", "-o", "new"),
        *("--resized", "cam1:0.25"),
    ),
    "images turned another way than is stated": (
        *("run", "turned", "--cameras", "scene/intrinsics.toml", "-o", "new"),
        *("--rotated", "cam1:180"),
    ),
    "sizes that nobody states": ("run", "sizeless", "-o", "new"),
    "a length of no joint": (*RUN, "--length", "nose-tail=0.4"),
    "millimetres without a scale": (*RUN, "--write", "trc", "--fps", "30"),
    "frames in no common range": (
        *(*RUN, "--frame-offset", "cam1:1000", "--frame-offset", "cam2:2000", "--sync", "off"),
    ),
    # files of another kind
    "intrinsics for keypoints": ("run", "scene/intrinsics.toml", "-o", "new"),
    "keypoints for intrinsics": (*BARE, "--cameras", "scene/keypoints/cam1.json"),
    "a picture for keypoints": ("run", "picture.png", "-o", "new"),
    "a video for keypoints": ("run", "video.mp4", "-o", "new"),
    "an empty folder": ("run", "empty", "-o", "new"),
    "intrinsics for a rig": (
        "evaluate",
        "out/cameras.yaml",
        "--reference",
        "scene/intrinsics.toml",
    ),
    "a rig of other cameras": ("evaluate", "out/cameras.yaml", "--reference", "plain.yaml"),
    # convert
    "a format that is none": (*CONVERT, "--to", "collmap"),
    "a format of another kind": (*CONVERT, "--to", "trc"),
    "a format that is only read": ("convert", "scene/keypoints", "new", "--to", "alphapose"),
    "no format": CONVERT,
    "an ending of two formats": ("convert", "scene/keypoints", "new.csv"),
    "an option of another kind": (*CONVERT, "--to", "anipose", "--fps", "30"),
    "no unit for millimetres": (*CONVERT, "--to", "freemocap"),
    "no rate for a timed format": ("convert", "out/poses3d.h5", "new.bvh"),
    "stdin without a format": ("convert", "-", "new.toml"),
    "the wrong format": (
        *("convert", "scene/keypoints/cam1.json", "new", "--from", "sleap", "--to", "csv"),
    ),
    # stages
    "triangulate without a rig": ("triangulate", "scene/keypoints", "-o", "new"),
    "results that are none": ("overlay", "scene", "--video", "cam1=video.mp4", "-o", "new"),
    "a report of nothing": ("report", "scene"),
    "a filter of no length": (
        *("filter", "out/poses3d.h5", "-o", "new.h5", "--method", "median", "--window", "0"),
    ),
    "a filter without a rate": ("filter", "out/poses3d.h5", "-o", "new.h5"),
    "heights of nobody": ("scale", "out", "--height", "7=1.75"),
    "simulate nobody": ("simulate", "-o", "new", "--people", "0"),
    "simulate a kind that is none": ("simulate", "-o", "new", "--kind", "cat"),
}


def lay_out(folder: Path) -> None:
    """Make the files that the refused commands name."""
    words = ("--cameras", 3, "--people", 1, "--frames", 60, "--seed", 3)
    assert call("simulate", "-o", "scene", *words, folder=folder).status == 0
    assert call(*RUN[:-1], "out", folder=folder).status == 0
    shutil.copytree(folder / "scene" / "keypoints", folder / "twice")
    shutil.copy(folder / "twice" / "cam1.json", folder / "twice" / "cam2.json")
    for name, size in (("half", (640, 360)), ("turned", (720, 1280)), ("sizeless", None)):
        shutil.copytree(folder / "scene" / "keypoints", folder / name)
        for path in sorted((folder / name).iterdir())[: 1 if size else 3]:
            _resize(path, size)
    (folder / "empty").mkdir()
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    (folder / "video.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + bytes(50))
    shutil.copy(CORPUS / "cameras" / "plain" / "cameras.yaml", folder / "plain.yaml")


def _resize(path: Path, size: tuple[int, int] | None) -> None:
    document = json.loads(path.read_text("utf-8"))
    for image in document["images"]:
        del image["width"], image["height"]
        if size:
            image.update(width=size[0], height=size[1])
    path.write_text(json.dumps(document), "utf-8")


def outcome(name: str, folder: Path) -> dict[str, Any]:
    """Return status and lines of stderr of a refused command, and what it wrote all the same.

    Of a mistake in the command line the usage, which the command prints first, is left out.
    """
    before = {path for path in folder.rglob("*") if path.is_file()}
    done = call(*REFUSALS[name], folder=folder)
    new = sorted(path for path in folder.rglob("*") if path.is_file() and path not in before)
    return {
        "status": done.status,
        "stderr": [line for line in done.stderr if line and not line.startswith(USAGE)],
        "files": {path.relative_to(folder).as_posix(): "" for path in new},
    }
