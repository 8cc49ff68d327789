"""What a report is made of, whether it comes from a run or from a folder of its results."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_calib.results import GroupResult, Matches, Poses3D
from mocap_calib.types import CameraRig, Floats, Record, Recording

MOST_KEYPOINTS = 1_000_000  # that are looked at for errors or for series


@dataclass(frozen=True, eq=False, repr=False)
class Seen(Record):
    """Detections and identities in the frames of the poses."""

    recording: Recording
    matches: Matches


@dataclass(frozen=True, eq=False, repr=False)
class Reference(Record):
    """Another rig, to be laid over that of the report. title: where it comes from."""

    title: str
    rig: CameraRig


@dataclass(frozen=True, eq=False, repr=False)
class ReportSource(Record):
    """What a report is made of.

    title: what it is of. run: what run.json holds of the group of cameras.
    rig: a camera that was moved is two views of it (`recording.corrections`).
    covariance: `[view, 3, 3]` of the centres, in the unit squared, NaN = not known.
    directed: whether that has directions; else it only says how far.
    edges: pairs of keypoints (indices) that the skeleton joins. fps: NaN = not known.
    seen: None where no keypoints were read. notes: what the report has to say of itself.
    """

    title: str
    run: Mapping[str, Any]
    rig: CameraRig
    covariance: Floats
    directed: bool
    poses: Poses3D
    edges: tuple[tuple[int, int], ...]
    fps: float
    seen: Seen | None
    reference: Reference | None = None
    notes: tuple[str, ...] = ()


def source_of_group(
    group: GroupResult,
    run: Mapping[str, Any],
    *,
    title: str,
    edges: tuple[tuple[int, int], ...],
    fps: float,
) -> ReportSource:
    """Return what the report of a group of cameras is made of.

    run: what its run.json holds. The other arguments are the fields of `ReportSource`.
    """
    covariance = group.uncertainty.covariance
    return ReportSource(
        title=title,
        run=run,
        rig=group.rig,
        covariance=np.einsum("vivj->vij", covariance.matrix[:, 3:, :, 3:]) * covariance.size**2,
        directed=True,
        poses=group.poses,
        edges=edges,
        fps=fps,
        seen=Seen(group.recording, group.matches),
    )


def select_individuals(source: ReportSource, most: int) -> tuple[ReportSource, list[int]]:
    """Return the source with the individuals of most points, and their numbers, ascending.

    Detections of the others are nobody's.
    """
    count = source.poses.positions.shape[1]
    if count <= most:
        return source, list(range(count))
    points = np.isfinite(source.poses.positions[..., 0]).sum((0, 2))
    kept = np.sort(np.argsort(-points, kind="stable")[:most])
    number = np.full(count + 1, -1)  # the last is that of nobody
    number[kept] = np.arange(most)
    seen = source.seen
    if seen is not None:
        seen = replace(seen, matches=Matches(number[seen.matches.labels]))
    note = f"{most} of {count} individuals are shown: those of most points"
    shown = replace(
        source, poses=source.poses.select(kept.tolist()), seen=seen, notes=(*source.notes, note)
    )
    return shown, kept.tolist()
