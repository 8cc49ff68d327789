"""Who is who: in which frames each camera shows each individual."""

from typing import Any

import numpy as np

from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.encode import pack, small_ints
from mocap_calib.html_report.source import Seen
from mocap_calib.recording.sampling import usual_step
from mocap_calib.types import Ints

_CONFIG = ReportConfig()


def describe_identities(seen: Seen) -> dict[str, Any]:
    """Return the runs of frames of each individual in each view, and the swaps, for a page.

    Where there are very many runs, the shortest gaps between them are closed.
    """
    runs = _find_runs(seen)
    runs, closed = _close_gaps(runs, _CONFIG.most_runs)
    swaps = _find_swaps(seen)
    return {
        "runs": pack(small_ints(runs), delta=0),
        "closed": closed,
        "swaps": pack(small_ints(swaps[: _CONFIG.most_swaps]), delta=0),
        "swaps_total": len(swaps),
    }


def _find_runs(seen: Seen) -> Ints:
    """Return rows (view, individual, first, last frame number), in this order."""
    frames, labels = seen.recording.frames, seen.matches.labels
    step = usual_step(frames)
    found = []
    for view, of_view in enumerate(labels):
        there = np.zeros((seen.matches.individuals, len(frames)), dtype=bool)
        frame, instance = np.nonzero(of_view >= 0)
        there[of_view[frame, instance], frame] = True
        who, when = np.nonzero(there)
        begins = np.ones(len(who), dtype=bool)
        begins[1:] = (np.diff(who) != 0) | (np.diff(frames[when]) > step)
        first, last = frames[when[begins]], frames[when[np.roll(begins, -1)]]
        found.append(np.column_stack([np.full(len(first), view), who[begins], first, last]))
    return np.concatenate(found) if found else np.zeros((0, 4), dtype=np.int64)


def _close_gaps(runs: Ints, most: int) -> tuple[Ints, int]:
    """Return the runs without their shortest gaps, and the longest gap that was closed.

    Of runs that cannot be that few by this, the longest are kept.
    """
    if len(runs) <= most:
        return runs, 0
    same = (np.diff(runs[:, :2], axis=0) == 0).all(1)
    gap = np.where(same, runs[1:, 2] - runs[:-1, 3], np.iinfo(np.int64).max)
    ordered = np.sort(gap[same])
    closed = int(ordered[min(len(runs) - most, len(ordered)) - 1]) if len(ordered) else 0
    begins = np.append(True, gap > closed)
    merged = runs[begins].copy()
    merged[:, 3] = runs[np.roll(begins, -1), 3]
    if len(merged) > most:
        longest = np.argsort(merged[:, 2] - merged[:, 3], kind="stable")[:most]
        merged = merged[np.sort(longest)]
    return merged, closed


def _find_swaps(seen: Seen) -> Ints:
    """Return rows (view, frame number, individual before, individual from then on), by frame.

    Of files that name individuals: where one name goes over to another individual.
    """
    rows = []
    for view in np.flatnonzero(seen.recording.tracked):
        labels = seen.matches.labels[view].T  # [instance, frame]
        instance, frame = np.nonzero(labels >= 0)
        who = labels[instance, frame]
        swap = np.flatnonzero((np.diff(instance) == 0) & (np.diff(who) != 0))
        number = seen.recording.frames[frame[swap + 1]]
        rows.append(np.column_stack([np.full(len(swap), view), number, who[swap], who[swap + 1]]))
    swaps = np.concatenate(rows) if rows else np.zeros((0, 4), dtype=np.int64)
    return swaps[np.argsort(swaps[:, 1], kind="stable")]
