"""Measure runs on real recordings as labs have them, one row each.

Intrinsics or clocks are rough or unknown, or a camera was bumped.

    .venv/bin/python benchmarks/real_rigs.py --recordings FOLDER [PART ...]

PART is a row's name, or a part of it; without one all rows are made. Each run is a process of its
own that sees the keypoints, and the intrinsics that the row says, alone. Rotation errors come from
`mocap-calib evaluate`; reference and true intrinsics are looked at for judging only. Exit status 1
where a figure is beyond its bound.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from real_rigs_rows import (
    ROUGH,
    STARTS,
    Figure,
    clocks,
    clocks_in_step,
    half_rate,
    late,
    moved,
    rough,
    starts,
    synced,
    unknown,
)
from recording_folders import add_recordings

# median E_R in degrees; relative error of the focal lengths
UNKNOWN = {
    "h36m_S1_walking": (1.0, 0.015),
    "h36m_S1_mix": (1.0, 0.015),
    "h36m_S5_multi3": (1.0, 0.015),
    "pose2sim_single": (1.5, np.inf),
    "shelf": (2.3, np.inf),
}
STARTED = ("h36m_S1_walking", "h36m_S5_multi3")
BUMPED = ("h36m_S1_mix", "h36m_S5_multi3", "humaneva_S1_projected", "shelf", "acinoset_lily_run")
BUMPS_DEG = (2, 10)
# every second frame of each camera, of some the odd ones: they are half a frame late then
HALF_RATE = {"shelf": (0, 1, 0, 1, 1)}
CLOCKS_IN_STEP = (
    "h36m_S1_walking",
    "h36m_S5_multi3",
    "humaneva_S1_projected",
    "panoptic_band1_projected",
    "two_dogs_projected",
    "dannce_two_mice_projected",
)
# `run` with and without a look at the frames of clocks: nothing changes, and it costs little
IN_STEP = (
    "h36m_S1_walking",
    "h36m_S1_mix",
    "h36m_S6_mix",
    "h36m_S5_multi3",
    "humaneva_S1_projected",
    "panoptic_band1_projected",
    "two_dogs_projected",
    "dannce_two_mice_projected",
)
# frames by which cameras are made late, from the first on
WHOLE_FRAMES = (
    ("h36m_S1_walking", (0, 3, -5, 8)),
    ("h36m_S5_multi3", (0, -4, 7, 11)),
    ("h36m_S5_multi3", (0, 1, -1, 1)),
    ("humaneva_S1_projected", (0, 3, -5)),
)
CLOCKS_OFF = ("acinoset_lily_run",)
CLOCKS_UNKNOWN = (
    "shelf",
    "pose2sim_single",
    "mvor_openpose",
    "eks_fly",
    "caliscope_4cam",
    "sleap_anipose_mouse",
)


def main() -> None:
    """Print one row after the other, as Markdown, and exit with 1 where one is beyond its bound."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART")
    add_recordings(parser)
    given = parser.parse_args()
    print("| row | figures | wall (s) |\n|---|---|---|")
    good = True
    for name, measure in rows(given.recordings):
        if given.parts and not any(part in name for part in given.parts):
            continue
        start = time.perf_counter()
        figures = measure()
        seconds = time.perf_counter() - start
        print(f"| {name} | {', '.join(map(str, figures))} | {seconds:.0f} |", flush=True)
        good = good and all(figure.value <= figure.bound for figure in figures)
    sys.exit(0 if good else 1)


def rows(recordings: Path) -> Iterator[tuple[str, Callable[[], list[Figure]]]]:
    """Yield the name of each row, and what measures it."""
    for name, (rotation, focal) in UNKNOWN.items():
        measure = partial(unknown, recordings / name, rotation_bound=rotation, focal_bound=focal)
        yield f"{name}, no intrinsics", measure
    for name in STARTED:
        yield f"{name}, starts of {STARTS} widths", partial(starts, recordings / name)
    for name in UNKNOWN:
        yield f"{name}, focal lengths {ROUGH:g} times as long", partial(rough, recordings / name)
    for name, offsets in WHOLE_FRAMES:
        yield f"{name}, offsets {offsets}", partial(late, recordings / name, offsets)
    for name in BUMPED:
        for degrees in BUMPS_DEG:
            measure = partial(moved, recordings / name, degrees=degrees)
            yield f"{name}, moved: a camera turned by {degrees} deg at half time", measure
    yield from clock_rows(recordings)


def clock_rows(recordings: Path) -> Iterator[tuple[str, Callable[[], list[Figure]]]]:
    """Yield the rows about clocks of recordings as they are, like `rows`."""
    for name, phase in HALF_RATE.items():
        yield f"{name}, clocks at half the rate", partial(half_rate, recordings / name, phase)
    for name in CLOCKS_IN_STEP:
        yield f"{name}, clocks in step", partial(clocks_in_step, recordings / name)
    for name in (*CLOCKS_OFF, *CLOCKS_UNKNOWN):
        yield f"{name}, clocks", partial(clocks, recordings / name, off=name in CLOCKS_OFF)
    for name in IN_STEP:
        yield f"{name}, in step, same bytes", partial(synced, recordings / name, in_step=True)
    for name in (*CLOCKS_OFF, *CLOCKS_UNKNOWN):
        yield f"{name}, frames of clocks", partial(synced, recordings / name, in_step=False)


if __name__ == "__main__":
    main()
