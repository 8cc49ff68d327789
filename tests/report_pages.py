"""Pages of reports for tests: made quickly, of simulated recordings, and read back.

`python -P tests/report_pages.py OUT.html` makes one of examples/three_people's kind to look at.
"""

import base64
import json
import re
import sys
import zlib
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scenes import calibrate_all, recording

from mocap_calib.html_report.encode import MISSING  # noqa: F401 - of points in a page
from mocap_calib.html_report.page import report_page
from mocap_calib.html_report.source import Reference, ReportSource, Seen, source_of_group
from mocap_calib.lift.lifter import load_vocabulary
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.report import run_report
from mocap_calib.results import Matches, Poses3D
from mocap_calib.types import CameraRig, Recording

_DATA = re.compile(r'<script type="application/json" id="report-data">(.*?)</script>', re.S)


def report_source(*, fps: float = 30.0, **scene: Any) -> ReportSource:
    """Return what the report of a simulated recording is made of. scene: as of `scenes.scene`."""
    result = calibrate_all(recording(**scene))
    group = result.groups[0]
    run = run_report(group, result, inputs={})
    groups = [{"folder": ".", "cameras": list(group.rig.names)}]
    more = {"date": "2026-01-31T12:00:00Z", "model": group.recording.model, "groups": groups}
    skeleton = load_vocabulary(group.recording.model)
    edges = edges_of_keypoints(skeleton, group.recording.vocabulary)
    return source_of_group(group, {**run, **more}, title="out", edges=edges, fps=fps)


def page_data(page: str) -> dict[str, Any]:
    """Return the data in a page."""
    (found,) = _DATA.findall(page)
    return json.loads(found)


def unpack(packed: dict[str, Any]) -> np.ndarray:
    """Return an array as web/src/data.d.ts says that a page reads it."""
    kind = np.dtype(packed["dtype"]).newbyteorder("<")
    content = zlib.decompress(base64.b64decode(packed["data"])) if packed["data"] else b""
    planes = np.frombuffer(content, dtype=np.uint8).reshape(kind.itemsize, -1)
    values = np.ascontiguousarray(planes.T).view(kind).reshape(packed["shape"])
    if packed["delta"] is None:
        return values
    return np.cumsum(values, axis=packed["delta"], dtype=kind)


def unpack_text(packed: dict[str, str]) -> str:
    """Return a text that was packed."""
    return zlib.decompress(base64.b64decode(packed["text"])).decode()


def timeless_run(run: dict[str, Any]) -> dict[str, Any]:
    """Return what run.json holds without the date and the times."""
    assert run["seconds"] != {}
    return {key: run[key] for key in run if key not in ("date", "seconds")}


def page_of(source: ReportSource, reference: CameraRig | None = None, **changes: Any) -> str:
    """Return the page of a source with some fields changed, beside a reference if there is one."""
    if reference is not None:
        changes["reference"] = Reference("a/ref.toml", reference)
    return report_page(replace(source, **changes))


# --- recordings far larger than those that tests calibrate, of noise, which no packing makes small


def large_source(
    small: ReportSource, *, cameras: int, people: int, frames: int, seed: int = 0
) -> ReportSource:
    """Return the source of a report of a recording of any size, in little memory.

    small: that of a recording that was calibrated, of which all else is taken.
    A frame of an array begins a number after the one before: each is of other noise.
    """
    rng = np.random.default_rng(seed)
    recording = small.seen.recording
    joints = len(recording.keypoints)
    rig = _spread_rig(small.rig, cameras)
    places = rng.normal(scale=0.01, size=frames + people * joints * 3)
    positions = _slide(places + 0.3, (frames, people, joints, 3))
    pixels = _slide(
        rng.uniform(0, 1000, size=frames + cameras * people * joints * 2).astype(np.float32),
        (frames, cameras, people, joints, 2),
    )
    labels = np.where(rng.random((cameras, frames, people)) < 0.9, np.arange(people), -1)
    shape = (frames, people, joints)
    full = np.broadcast_to(1.0, shape)
    numbers = np.arange(frames)
    poses = Poses3D(
        keypoints=recording.keypoints,
        frames=numbers,
        positions=positions,
        error=full,
        views=np.broadcast_to(2, shape),
        confidence=full,
        unit="m",
        raw=positions,
        source=np.broadcast_to(np.int8(1), shape),
        world=small.poses.world,
    )
    seen = Recording(
        cameras=rig.cameras,
        keypoints=recording.keypoints,
        frames=numbers,
        positions=np.moveaxis(pixels, 1, 0),
        confidence=np.broadcast_to(np.float32(1), (cameras, *shape)),
        tracked=np.ones(cameras, dtype=bool),
        vocabulary=recording.vocabulary,
    )
    return replace(
        small,
        run=_spread_run(small.run, rig.names, people, rng),
        rig=rig,
        covariance=np.tile(np.eye(3) * 1e-4, (cameras, 1, 1)),
        poses=poses,
        seen=Seen(seen, Matches(labels)),
    )


def _slide(noise, shape):
    """Return an array of noise whose first axis goes on by one number."""
    each = noise.itemsize
    strides = [each * int(np.prod(shape[k + 1 :])) for k in range(1, len(shape))]
    return as_strided(noise, shape, (each, *strides), writeable=False)


def _spread_rig(rig: CameraRig, count: int) -> CameraRig:
    """Return a rig of the cameras again and again, under names of their own."""
    which = np.arange(count) % len(rig)
    cameras = [replace(rig.cameras[k], name=f"camera {n}") for n, k in enumerate(which)]
    translation = rig.translation[which] + 0.1 * np.arange(count)[:, None]
    return replace(
        rig, cameras=tuple(cameras), rotation=rig.rotation[which], translation=translation
    )


def _spread_run(run, names, people, rng):
    """Return run.json as that of a rig of these cameras, with numbers of noise."""

    def noisy(value):
        if isinstance(value, dict):
            return {key: noisy(each) for key, each in value.items()}
        return float(rng.random()) if isinstance(value, float) else value

    camera, pair = run["cameras"][0], run["pairs"][0]
    other = {"score": 0.1, "turned_deg": 90.0}
    return {
        **run,
        "cameras": [{**noisy(camera), "name": name} for name in names],
        "pairs": [
            {**noisy(pair), "a": a, "b": b, "alternatives": [noisy(other) for _ in range(4)]}
            for a, b in combinations(names, 2)
        ],
        "individuals": [
            {"individual": k, "frames": 1000, "cameras": dict.fromkeys(names, 1000)}
            for k in range(people)
        ],
    }


if __name__ == "__main__":
    source = report_source(cameras=4, people=3, frames=120)
    Path(sys.argv[1]).write_text(report_page(source), encoding="utf-8", newline="\n")
