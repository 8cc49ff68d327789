"""C3D of motion capture: float32, millimetres, frames counted from 1 without gaps, at most 255 markers."""

import io
import warnings

import c3d
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import malformed, one_line
from mocap_calib.io.poses.common import (
    DAMAGE,
    PoseFile,
    WrittenPoses,
    bare_poses,
    convert_unit,
    fill_gaps,
    lost_quality,
    need_keypoints,
    need_rate,
)
from mocap_calib.io.units import known_unit
from mocap_calib.types import Floats, Ints

_MOST = 255  # the header of a file counts markers in a byte
_MARK = b"\x50"  # of a C3D file, its second byte
_ALONE = "individual_0"


def sniff(content: bytes) -> bool:
    """By the mark, and where the first byte says that the parameters begin."""
    return len(content) >= 512 and content[1:2] == _MARK and content[:1] == b"\x02"


def parse(content: bytes, source: str) -> PoseFile:
    """The markers; `name:marker` are those of an individual, where all are. Raises FormatError."""
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            names, frames, points, rate, unit = _read(content)
    except DAMAGE as error:
        raise malformed(
            source, "a whole C3D file", f"an error ({one_line(error)})", "write the file again"
        ) from None
    if any("end of file" in str(warning.message) for warning in said) or not len(frames):
        raise malformed(source, "a whole C3D file", "one that is cut", "copy it again")
    individuals, keypoints = _split(names)
    unit = known_unit(unit, f"{source}: POINT:UNITS")
    if len(individuals) * len(keypoints) != len(names) or len(set(names)) < len(names):
        raise malformed(
            source,
            "the same markers of every individual, each once",
            ", ".join(names[:8]),
            "rename the markers",
        )
    # the markers of one individual need not stand together
    order = [
        names.index(f"{who}:{what}") if who else names.index(what)
        for who in individuals
        for what in keypoints
    ]
    positions = points[:, order].reshape(len(frames), len(individuals), len(keypoints), 3)
    return PoseFile(
        bare_poses(keypoints, frames, positions, unit),
        rate,
        tuple(who or _ALONE for who in individuals),
    )


def _read(content: bytes) -> tuple[list[str], Ints, Floats, float, str]:
    """Labels, `[frame]` numbers from 0, `[frame, marker, 3]`, frames per second, unit."""
    reader = c3d.Reader(io.BytesIO(content))
    names = [label.strip() for label in reader.point_labels]
    found = [
        (number, points[:, :4].astype(np.float64)) for number, points, _ in reader.read_frames()
    ]
    frames = np.array([number for number, _ in found], dtype=np.int64) - 1
    points = np.stack([points for _, points in found]) if found else np.zeros((0, len(names), 4))
    if points.shape[1] < len(names) or not names:
        raise ValueError(f"{points.shape[1]} markers and {len(names)} labels")
    points = points[:, : len(names)]
    units = reader.get("POINT:UNITS")
    positions = np.where(
        (points[..., 3:] < 0) | ~np.isfinite(points[..., :3]).all(-1, keepdims=True),
        np.nan,
        points[..., :3],
    )
    return (
        names,
        frames,
        positions,
        float(reader.point_rate),
        units.string_value.strip() if units is not None else "",
    )


def _split(names: list[str]) -> tuple[list[str], list[str]]:
    """Individuals ("" where the markers are nobody's) and keypoints."""
    pairs = [name.partition(":") for name in names]
    if not all(who and colon and what for who, colon, what in pairs):
        return [""], names
    return list(dict.fromkeys(who for who, _, _ in pairs)), list(
        dict.fromkeys(what for _, _, what in pairs)
    )


def write(file: PoseFile, title: str) -> WrittenPoses:  # noqa: ARG001 - the writers' signature
    """All individuals, their markers called name:marker unless there is one without a name. Raises MismatchError."""
    rate = need_rate(file, "c3d")
    need_keypoints(
        file, r"(?! )[ -9;-~]{1,60}(?<! )", "1 to 60 letters of ASCII without a colon", "c3d"
    )
    alone = file.individuals == (_ALONE,)
    names = [
        what if alone else f"{who}:{what}"
        for who in file.individuals
        for what in file.poses.keypoints
    ]
    if not 0 < len(names) <= _MOST:
        raise MismatchError(
            f"c3d: expected 1 to {_MOST} markers, found {len(names)} (individuals x keypoints); write fewer individuals or another format"
        )
    frames, positions = fill_gaps(convert_unit(file, "mm", "c3d").poses, "c3d")
    if frames[0] < 0 or not _exact(rate):
        raise MismatchError(
            f"c3d: expected frames from 0 on and a rate that fits, found frame {frames[0]} and rate {rate}; shift the frames"
        )
    points = positions.reshape(len(frames), len(names), 3)
    missing = ~np.isfinite(points).all(-1, keepdims=True)
    # no residual and no cameras are known in its terms; -1 marks a missing point
    table = np.concatenate(
        [
            np.where(missing, 0.0, points),
            np.where(missing, -1.0, 0.0),
            np.zeros_like(points[..., :1]),
        ],
        axis=-1,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it misses analog channels
        content = _content(table, names, rate, int(frames[0]) + 1)
    return WrittenPoses(content, lost_quality(file))


def _content(table: Floats, names: list[str], rate: float, first: int) -> bytes:
    """`[frame, marker, 5]` x, y, z, residual, cameras as a file."""
    writer = c3d.Writer(point_rate=rate, point_units="mm")
    writer.set_point_labels(names)
    writer.set_start_frame(first)
    nothing = np.zeros((0, 1))
    writer.add_frames([(frame, nothing) for frame in table])
    content = io.BytesIO()
    writer.write(content)
    return content.getvalue()


def _exact(rate: float) -> bool:
    return 0 < rate < float(np.finfo(np.float32).max)
