"""kinematics.csv and bones.csv: what follows from poses, as tables; docs/kinematics.md."""

from collections.abc import Iterator, Mapping, Sequence
from math import isnan
from pathlib import Path

import numpy as np

from mocap_calib.io.atomic import write_files
from mocap_calib.io.table import format_csv_line, slice_frames
from mocap_calib.io.units import ARBITRARY
from mocap_calib.kinematics import Kinematics
from mocap_calib.types import Floats

TABLE = "kinematics.csv"
BONES = "bones.csv"
_DIGITS = 6  # significant: a millionth of what is measured
_BONE_COLUMNS = ("individual", "bone", "mean", "sd", "frames", "unit")


def write_kinematics(folder: Path, found: Kinematics, individuals: Sequence[str]) -> None:
    """Write both tables into a folder, which is made, together or not at all.

    individuals: `[individual]` names.
    """
    tables = {
        TABLE: "".join(kinematics_csv(found, individuals)),
        BONES: "".join(bones_csv(found, individuals)),
    }
    write_files(folder, {name: text.encode("utf-8") for name, text in tables.items()})


def kinematics_csv(found: Kinematics, individuals: Sequence[str]) -> Iterator[str]:
    """Yield the table of frames in pieces: a row for each individual and frame.

    Frames in which nothing was found of an individual have no row. Cells are empty where a number
    is missing.
    """
    columns = _columns(found)
    timed = np.isfinite(found.rate)
    first = ("individual", "frame", *(("time_s",) if timed else ()))
    yield format_csv_line([*first, *columns])
    if not columns:
        return
    for number, individual in enumerate(individuals):
        name = format_csv_line([individual]).rstrip("\n")
        for piece in slice_frames(len(found.frames), len(columns)):
            table = np.stack([column[piece, number] for column in columns.values()], axis=-1)
            for frame, row in zip(found.frames[piece].tolist(), table, strict=True):
                if np.isfinite(row).any():
                    time = f",{frame / found.rate:.{_DIGITS}f}" if timed else ""
                    yield f"{name},{frame}{time},{_format_row(row)}\n"


def bones_csv(found: Kinematics, individuals: Sequence[str]) -> Iterator[str]:
    """Yield the table of bones: a row for each individual and bone."""
    yield format_csv_line(_BONE_COLUMNS)
    for number, individual in enumerate(individuals):
        for k, bone in enumerate(found.bones):
            lengths = [found.bone_mean[number, k], found.bone_sd[number, k]]
            cells = _format_row(np.array(lengths)).split(",")
            frames = str(found.bone_frames[number, k])
            yield format_csv_line([individual, bone, *cells, frames, found.unit])


def _columns(found: Kinematics) -> Mapping[str, Floats]:
    """Return the values `[frame, individual]` by the names of their columns, which say the unit."""
    length = "units" if found.unit == ARBITRARY else found.unit
    per = "s" if np.isfinite(found.rate) else "frame"
    return {
        **{f"{name}_angle_deg": values for name, values in found.angles.items()},
        **{f"{name}_speed_{length}_per_{per}": values for name, values in found.speeds.items()},
        **{f"{name}_contact": values for name, values in found.contacts.items()},
    }


def _format_row(row: Floats) -> str:
    """Return numbers with commas between them, nothing for NaN."""
    return ",".join("" if isnan(value) else f"{value:.{_DIGITS}g}" for value in row.tolist())
