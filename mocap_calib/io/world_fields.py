"""What files say of the axes, the origin and the unit of their coordinates.

The same fields stand in run.json, cameras.yaml, the metadata of TOML, and as JSON in an attribute
of poses3d.h5; docs/world.md says what each means.
"""

import math
from typing import Any

import msgspec
import numpy as np

from mocap_calib.io.file import unsigned_zeros
from mocap_calib.types import METRES, World


def world_fields(world: World, unit: str) -> dict[str, Any]:
    """Return what is known of a world, None for what is not.

    unit: of the lengths.
    """
    cues = [
        {
            "cue": cue.text,
            "metres": cue.metres,
            "measured": cue.measured,
            "sigma_percent": 100 * cue.sigma,
            "residual": _if_known(cue.residual),
        }
        for cue in world.cues
    ]
    fields = {
        "kind": world.kind,
        "camera": world.camera or None,
        "up": _if_known(world.up),
        "up_sigma_deg": _if_known(np.degrees(world.up_sigma)),
        "floor": _if_known(world.floor),
        "floor_sigma": _if_known(world.floor_sigma),
        "unit": unit,
        "scale_sigma_percent": _if_known(100 * world.scale_sigma) if unit in METRES else None,
        "cues": cues,
        "landmarks": [
            {"name": each.name, "distance_m": _if_known(each.distance)} for each in world.landmarks
        ],
        "remarks": list(world.remarks),
        "axes_unmet": world.axes_unmet or None,
        "scale_unmet": world.scale_unmet or None,
    }
    plain: dict[str, Any] = unsigned_zeros(fields)
    return plain


def stated_world(world: World, unit: str) -> dict[str, Any]:
    """Return the field `world` for a file, nothing where the axes are not known."""
    return {} if world.kind == "not known" else {"world": world_fields(world, unit)}


def read_world(stored: Any) -> World:
    """Return the world that a file says; one that was edited into something else is not known."""
    try:
        fields = _without_unknown(stored)
        fields["up_sigma"] = math.radians(fields.pop("up_sigma_deg", math.nan))
        fields["scale_sigma"] = fields.pop("scale_sigma_percent", math.nan) / 100
        fields["cues"] = [
            {"residual": math.nan, **cue, "text": cue["cue"], "sigma": cue["sigma_percent"] / 100}
            for cue in map(_without_unknown, fields.get("cues", []))
        ]
        fields["landmarks"] = [
            {"name": each["name"], "distance": each.get("distance_m", math.nan)}
            for each in map(_without_unknown, fields.get("landmarks", []))
        ]
        world = msgspec.convert(fields, World, dec_hook=lambda _, numbers: np.array(numbers))
    except (msgspec.ValidationError, LookupError, TypeError, AttributeError, OverflowError):
        return World()
    texts = [world.camera, world.axes_unmet, world.scale_unmet, *world.remarks]
    texts += [cue.text for cue in world.cues] + [each.name for each in world.landmarks]
    return world if "".join(texts).isprintable() and world.kind != "not known" else World()


def _without_unknown(stored: Any) -> dict[str, Any]:
    return {key: value for key, value in stored.items() if value is not None}


def _if_known(values: Any) -> Any:
    """Return a number, or numbers as a list; None where one is not finite."""
    return np.asarray(values, dtype=np.float64).tolist() if np.isfinite(values).all() else None
