"""Rigs and results as HTML, which notebooks show in place of their text.

Names come from files of others: everything is escaped.
"""

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from mocap_calib.errors import count
from mocap_calib.results import CalibrationResult, GroupResult
from mocap_calib.types import Camera, CameraRig, EstimatedCamera, Floats, describe_unit

_HEADER = ("camera", "image", "focal length (px)", "centre")
_SIGMAS = ("rotation (deg, 1 SD)", "centre (% of the rig, 1 SD)")


def describe_rig(rig: CameraRig) -> str:
    """Return a rig as HTML: each camera, its focal length and its centre."""
    title = f"<p><b>{escape(count(len(rig), 'camera'))}</b>, {escape(describe_unit(rig.unit))}</p>"
    return f"{title}{_table(_HEADER, _describe_cameras(rig))}"


def _describe_cameras(rig: CameraRig) -> list[list[str]]:
    """Return the row of each camera."""
    return [
        [
            camera.name,
            f"{camera.size[0]} x {camera.size[1]}",
            _describe_focal(camera),
            _describe_point(centre),
        ]
        for camera, centre in zip(rig.cameras, rig.centres, strict=True)
    ]


def describe_result(result: CalibrationResult) -> str:
    """Return a result as HTML: the verdict on each group of cameras, its reasons, and the rig."""
    parts = [describe_group(group) for group in result.groups]
    faults = [f"{fault.camera}: {fault.says}" for fault in result.faults]
    if result.left_out:
        faults.append(f"left out, as nothing confirms them: {', '.join(result.left_out)}")
    return "".join([*parts, _list(faults)])


def describe_group(group: GroupResult) -> str:
    """Return a group of cameras as HTML: the verdict, its reasons, what was found, and the rig."""
    frames, individuals = group.poses.positions.shape[:2]
    found = f"{count(individuals, 'individual')} in {count(frames, 'frame')}"
    verdict = f"<p><b>The rig is {escape(group.verdict)}.</b> {escape(found)}.</p>"
    covariance = group.uncertainty.covariance
    sigmas = zip(np.rad2deg(covariance.rotation_sigma), 100 * covariance.centre_sigma, strict=True)
    rows = [
        [*row, f"± {turn:.2g}", f"± {shift:.2g}"]
        for row, (turn, shift) in zip(_describe_cameras(group.rig), sigmas, strict=True)
    ]
    return f"{verdict}{_list(map(str, group.reasons))}{_table((*_HEADER, *_SIGMAS), rows)}"


def _describe_focal(camera: Camera) -> str:
    """Return the focal length of a camera, and how sure it is where it was estimated."""
    sigma = f" ± {camera.focal_sigma:.1f}" if isinstance(camera, EstimatedCamera) else ""
    return f"{camera.focal:.1f}{sigma}"


def _describe_point(point: Floats) -> str:
    """Return the coordinates of a point in a few digits."""
    return ", ".join(f"{coordinate + 0.0:.4g}" for coordinate in point)  # no -0


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as HTML."""
    lines = [_row("th", header), *(_row("td", row) for row in rows)]
    return f"<table>{''.join(lines)}</table>"


def _row(tag: str, cells: Iterable[str]) -> str:
    """Return a row of a table as HTML."""
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _list(lines: Iterable[str]) -> str:
    """Return lines as a list in HTML, nothing where there are none."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""
