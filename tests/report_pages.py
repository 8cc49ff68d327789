"""Pages of reports for tests: made quickly, of simulated recordings, and read back.

`python -P tests/report_pages.py OUT.html` makes one of examples/three_people's kind to look at.
"""

import base64
import json
import re
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from scenes import calibrate_all, recording

from mocap_calib.html_report.page import report_page
from mocap_calib.html_report.source import ReportSource, source_of_group
from mocap_calib.lift.lifter import load_vocabulary
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.report import run_report

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


if __name__ == "__main__":
    source = report_source(cameras=4, people=3, frames=120)
    Path(sys.argv[1]).write_text(report_page(source), encoding="utf-8", newline="\n")
