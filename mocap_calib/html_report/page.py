"""The page: one HTML file that holds its program, its looks and its data, and asks for nothing.

web/src/data.d.ts has the form of the data. What must be whole comes first; the bodies and then the
detections fill what is left of the bytes.
"""

import base64
import hashlib
import html
import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from mocap_calib.errors import count
from mocap_calib.html_report.bodies import describe_bodies, describe_series
from mocap_calib.html_report.encode import pack_text, packed_size, to_script
from mocap_calib.html_report.rig import describe_reference, describe_rig
from mocap_calib.html_report.source import ReportSource, select_individuals
from mocap_calib.html_report.views import describe_detections, describe_fits, describe_identities
from mocap_calib.recording.joints import normalise_name
from mocap_calib.verdict.checks import describe_checks

SCHEMA = 1  # goes up when the form of the data changes
_OF_ONE_RUN = {"date", "seconds", "inputs", "outputs", "fingerprint"}  # keys of run.json
_NO_KEYPOINTS = "no keypoints were read: what the cameras saw is not shown"
_NO_ALTERNATIVES = "too many pairs: their alternatives are left out"
_LIMIT = 2_990_000  # bytes of the page
_SPARE = 4000  # bytes that are kept free
_SHARE_OF_RUN = 0.5  # of the bytes for data, that run.json may take
_SHARE_OF_BODIES = 0.6  # of what is left after all else; the rest is for detections
_MOST_INDIVIDUALS = 100  # that are shown
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<div id="app"></div>
<noscript>This report is drawn by a program in the page: allow JavaScript for it. The same numbers \
are in run.json beside it.</noscript>
<script type="application/json" id="report-data">{data}</script>
<script>{program}</script>
</body>
</html>
"""


def report_page(source: ReportSource) -> str:
    """Return report.html, in fewer bytes than `_LIMIT`.

    Raises MismatchError where a reference does not go with the rig.
    """
    title = f"{source.title}: mocap-calib"
    room = _LIMIT - len(_fill(title, "").encode())
    return _fill(title, to_script(_describe_report(source, room)))


def _fill(title: str, data: str) -> str:
    """Return the page; `data` stands in it as it is."""
    program, style = _asset("page.js"), _asset("page.css")
    # nothing but what stands here may run, load or be sent
    policy = (
        f"default-src 'none'; script-src {_hash(program)}; style-src {_hash(style)}; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return _PAGE.format(
        policy=policy, title=html.escape(title), style=style, data=data, program=program
    )


@cache
def _asset(name: str) -> str:
    """Return a file of the bundle, which `make web` makes of the sources in web/."""
    path = resources.files("mocap_calib.html_report") / name
    return path.read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return what a content security policy calls an element of this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _describe_report(source: ReportSource, room: int) -> dict[str, Any]:
    """Return the data of a page in at most `room` bytes.

    Raises MismatchError where a reference does not go with the rig.
    """
    source, individuals = select_individuals(source, _MOST_INDIVIDUALS)
    run, left = _describe_run(source.run, room)
    notes = [*source.notes, *left]
    seen, joints = source.seen, source.poses.keypoints
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "title": source.title,
        "run": run,
        "checks": describe_checks(),
        "rig": describe_rig(source),
        "reference": source.reference and describe_reference(source.reference, source.rig),
        "skeleton": {
            "joints": list(joints),
            "edges": [list(edge) for edge in source.edges],
            "sides": [_side_of(name) for name in joints],
        },
        "series": describe_series(source),
        "timeline": seen and describe_identities(seen),
        "fits": seen and describe_fits(seen, source.rig, source.poses),
    }
    spare = room - packed_size(data) - _SPARE
    for part in ("fits", "timeline"):  # of rigs of a size that nobody has seen yet
        if spare < 0 and data[part] is not None:
            spare += packed_size(data[part])
            data[part] = None
            notes.append(f"too many cameras: the part {part} is left out")
    for_bodies = int(max(spare, 0) * (_SHARE_OF_BODIES if seen else 1))
    bodies, shown = describe_bodies(source, individuals, for_bodies)
    data["poses"] = bodies
    rest = spare - packed_size(bodies)
    data["detections"] = seen and describe_detections(seen, shown, max(rest, 0))
    if not seen:
        notes.append(_NO_KEYPOINTS)
    total = len(source.poses.frames)
    if len(shown) < total:
        notes.append(
            f"bodies are shown in {len(shown)} of {count(total, 'frame')}, in stretches; "
            "all frames are in poses3d.h5"
        )
    data["notes"] = notes
    return data


def _describe_run(run: Mapping[str, Any], room: int) -> tuple[dict[str, str], list[str]]:
    """Return run.json for a page, and what had to be left out of it, a line each.

    Dates, times and hashes stay in run.json: the same input gives the same page. Lists of pairs
    know no limit.
    """
    run = {key: value for key, value in run.items() if key not in _OF_ONE_RUN}
    pairs, left = run["pairs"], []
    for shown, note in (
        (pairs, ""),
        ([{**pair, "alternatives": []} for pair in pairs], _NO_ALTERNATIVES),
        ([], f"{count(len(pairs), 'pair')}: too many to be shown"),
    ):
        left += [note] if note else []
        text = json.dumps({**run, "pairs": shown}, separators=(",", ":"), allow_nan=False)
        packed = pack_text(text)
        if packed_size(packed) <= room * _SHARE_OF_RUN:
            break
    return packed, left


def _side_of(name: str) -> str:
    """Return on which side a joint is, by its name once that is spelt out."""
    spelt = normalise_name(name)
    return next((side for side in ("left", "right") if spelt.startswith(side)), "middle")
