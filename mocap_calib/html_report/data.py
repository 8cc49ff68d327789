"""The data of a page (web/src/data.d.ts has their form), within the bytes that there are for them.

What must be whole comes first; the bodies and then the detections fill what is left.
"""

import json
from collections.abc import Mapping
from typing import Any

from mocap_calib.errors import count
from mocap_calib.html_report.bodies import describe_bodies
from mocap_calib.html_report.cameras import describe_reference, describe_rig
from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.detections import describe_detections
from mocap_calib.html_report.encode import pack_text, packed_size
from mocap_calib.html_report.fits import describe_fits
from mocap_calib.html_report.identities import describe_identities
from mocap_calib.html_report.series import describe_series
from mocap_calib.html_report.source import ReportSource, select_individuals
from mocap_calib.recording.joints import normalise_name
from mocap_calib.verdict.checks import describe_checks

SCHEMA = 1  # goes up when the form of the data changes
_CONFIG = ReportConfig()
_OF_ONE_RUN = {"date", "seconds", "inputs", "outputs", "fingerprint"}  # keys of run.json
_NO_KEYPOINTS = "no keypoints were read: what the cameras saw is not shown"


def describe_report(source: ReportSource, room: int) -> dict[str, Any]:
    """Return the data of a page in at most `room` bytes.

    Raises MismatchError where a reference does not go with the rig.
    """
    source, individuals = select_individuals(source, _CONFIG.most_individuals)
    notes = list(source.notes)
    run, left = _describe_run(source.run, room)
    notes += left
    seen = source.seen
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "title": source.title,
        "run": run,
        "checks": describe_checks(),
        "rig": describe_rig(source),
        "reference": source.reference and describe_reference(source.reference, source.rig),
        "skeleton": _describe_skeleton(source),
        "series": describe_series(source),
        "timeline": seen and describe_identities(seen),
        "fits": seen and describe_fits(seen, source.rig, source.poses),
    }
    spare = room - packed_size(data) - _CONFIG.spare
    for part in ("fits", "timeline"):  # of rigs of a size that nobody has seen yet
        if spare < 0 and data[part] is not None:
            spare += packed_size(data[part])
            data[part] = None
            notes.append(f"too many cameras: the part {part} is left out")
    for_bodies = int(max(spare, 0) * (_CONFIG.share_of_bodies if seen else 1))
    bodies, shown = describe_bodies(source, individuals, for_bodies)
    data["poses"] = bodies
    rest = spare - packed_size(bodies)
    data["detections"] = seen and describe_detections(seen, shown, max(rest, 0))
    data["notes"] = [*notes, *_remark_frames(source, len(shown))]
    return data


def _describe_run(run: Mapping[str, Any], room: int) -> tuple[dict[str, str], list[str]]:
    """Return run.json for a page, and what had to be left out of it, a line each.

    Dates, times and hashes stay in run.json: the same input gives the same page. Lists of pairs
    know no limit.
    """
    run = {key: value for key, value in run.items() if key not in _OF_ONE_RUN}
    left = []
    for shorten in (_all_of_it, _no_alternatives, _no_pairs):
        shorter, note = shorten(run)
        if note:
            run = shorter
            left.append(note)
        packed = pack_text(json.dumps(run, separators=(",", ":"), allow_nan=False))
        if packed_size(packed) <= room * _CONFIG.share_of_run:
            break
    return packed, left


_Shortened = tuple[Mapping[str, Any], str]


def _all_of_it(run: Mapping[str, Any]) -> _Shortened:
    return run, ""


def _no_alternatives(run: Mapping[str, Any]) -> _Shortened:
    pairs = [{**pair, "alternatives": []} for pair in run["pairs"]]
    return {**run, "pairs": pairs}, "too many pairs: their alternatives are left out"


def _no_pairs(run: Mapping[str, Any]) -> _Shortened:
    return {**run, "pairs": []}, f"{count(len(run['pairs']), 'pair')}: too many to be shown"


def _describe_skeleton(source: ReportSource) -> dict[str, Any]:
    """Return the joints, what joins them, and on which side they are."""
    joints = source.poses.keypoints
    return {
        "joints": list(joints),
        "edges": [list(edge) for edge in source.edges],
        "sides": [_side_of(name) for name in joints],
    }


def _side_of(name: str) -> str:
    """Return on which side a joint is, by its name once that is spelt out."""
    spelt = normalise_name(name)
    return next((side for side in ("left", "right") if spelt.startswith(side)), "middle")


def _remark_frames(source: ReportSource, shown: int) -> list[str]:
    """Return what the page must say of what it does not show."""
    total = len(source.poses.frames)
    notes = [] if source.seen else [_NO_KEYPOINTS]
    if shown < total:
        notes.append(
            f"bodies are shown in {shown} of {count(total, 'frame')}, in stretches; "
            "all frames are in poses3d.h5"
        )
    return notes
