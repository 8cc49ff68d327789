"""What files say of the axes, the origin and the unit of their coordinates.

The same fields stand in run.json, cameras.yaml, the metadata of TOML, and as JSON in an attribute
of poses3d.h5; docs/world.md says what each means.
"""

import math
import sys
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.types import (
    METRES,
    WORLD_KINDS,
    Floats,
    MeasuredCue,
    MeasuredLandmark,
    World,
    WorldKind,
)


def world_fields(world: World, unit: str) -> dict[str, Any]:
    """Return what is known of a world, None for what is not.

    unit: of the lengths.
    """
    fields = {
        "kind": world.kind,
        "camera": world.camera or None,
        "up": _list_if_known(world.up),
        "up_sigma_deg": _if_finite(np.degrees(world.up_sigma)),
        "floor": _list_if_known(world.floor),
        "floor_sigma": _if_finite(world.floor_sigma),
        "unit": unit,
        "scale_sigma_percent": _if_finite(100 * world.scale_sigma) if unit in METRES else None,
        "cues": [
            {
                "cue": cue.text,
                "metres": cue.metres,
                "measured": cue.measured,
                "sigma_percent": 100 * cue.sigma,
                "residual": _if_finite(cue.residual),
            }
            for cue in world.cues
        ],
        "landmarks": [
            {"name": landmark.name, "distance_m": _if_finite(landmark.distance)}
            for landmark in world.landmarks
        ],
        "remarks": list(world.remarks),
        "axes_unmet": world.axes_unmet or None,
        "scale_unmet": world.scale_unmet or None,
    }
    plain: dict[str, Any] = unsigned_zeros(fields)
    return plain


def stated_world(world: World, unit: str) -> dict[str, Any]:
    """Return the field `world` for a file, nothing where nobody knows what the axes are."""
    return {} if world.kind == "not known" else {"world": world_fields(world, unit)}


def read_world(stored: Any) -> World:
    """Return the world that a file says; what was edited into something else is left out."""
    if not isinstance(stored, Mapping):
        return World()
    kind: WorldKind = next(
        (each for each in WORLD_KINDS if each == stored.get("kind")), "not known"
    )
    if kind == "not known":
        return World()
    remarks = stored.get("remarks")
    return World(
        kind=kind,
        camera=_read_text(stored.get("camera")),
        up=_read_vector(stored.get("up")),
        up_sigma=math.radians(_read_number(stored.get("up_sigma_deg"))),
        floor=_read_vector(stored.get("floor")),
        floor_sigma=_read_number(stored.get("floor_sigma")),
        scale_sigma=_read_number(stored.get("scale_sigma_percent")) / 100,
        remarks=tuple(each for each in remarks if isinstance(each, str) and each.isprintable())
        if isinstance(remarks, list)
        else (),
        cues=_read_cues(_read_rows(stored.get("cues"), "cue")),
        landmarks=tuple(map(_read_landmark, _read_rows(stored.get("landmarks"), "name"))),
        axes_unmet=_read_text(stored.get("axes_unmet")),
        scale_unmet=_read_text(stored.get("scale_unmet")),
    )


def _read_rows(stored: Any, name: str) -> list[Mapping[str, Any]]:
    """Return the rows of a list that have a name, which is the field of that name."""
    rows = stored if isinstance(stored, list) else []
    return [
        row
        for row in rows
        if isinstance(row, Mapping) and isinstance(row.get(name), str) and row[name].isprintable()
    ]


def _read_cues(rows: Iterable[Mapping[str, Any]]) -> tuple[MeasuredCue, ...]:
    """Return the cues whose numbers are all there, but for the residual."""
    found = []
    for row in rows:
        columns = ("metres", "measured", "sigma_percent")
        metres, measured, percent = (_read_number(row.get(column)) for column in columns)
        if math.isfinite(metres + measured + percent):
            residual = _read_number(row.get("residual"))
            found.append(MeasuredCue(row["cue"], metres, measured, percent / 100, residual))
    return tuple(found)


def _read_landmark(row: Mapping[str, Any]) -> MeasuredLandmark:
    return MeasuredLandmark(row["name"], _read_number(row.get("distance_m")))


def _if_finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _list_if_known(vector: Floats) -> list[float] | None:
    return [float(part) for part in vector] if np.isfinite(vector).all() else None


def _read_text(value: Any) -> str:
    """Return a text, an empty one for anything else."""
    return value if isinstance(value, str) and value.isprintable() else ""


def _read_number(value: Any) -> float:
    """Return a number, NaN for anything else."""
    known = type(value) in (int, float) and abs(value) <= sys.float_info.max
    return float(value) if known else math.nan


def _read_vector(value: Any) -> Floats:
    """Return `[3]` numbers, all NaN for anything else."""
    numbers = [_read_number(part) for part in value] if isinstance(value, list) else []
    known = len(numbers) == 3 and all(map(math.isfinite, numbers))
    return np.array(numbers if known else [math.nan] * 3)
