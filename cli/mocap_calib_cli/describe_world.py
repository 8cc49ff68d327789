"""What a person wants to know of the coordinates of results."""

from collections.abc import Mapping
from typing import Any

from mocap_calib.types import ARBITRARY

_NOT_SCALED = (
    "lengths are arbitrary: one that is known sets the scale (--height, --length, "
    "--camera-distance; afterwards `mocap-calib scale`)"
)
_UNIT_OF_FILE = (
    "lengths are arbitrary, as the file of the world does not say its unit: `mocap-calib convert "
    "FILE NEW --input-unit m` writes it down; a known length (--height, --length, "
    "--camera-distance) says another"
)
_UNMET = ("axes_unmet", "scale_unmet")


def describe_world(world: Mapping[str, Any]) -> list[str]:
    """Say in a line what the coordinates are, then what each known length and landmark says.

    world: as `io.world_fields` has it.
    """
    said = [*world["remarks"], _describe_unit(world)]
    if world["kind"] == "floor":
        said.insert(0, "z is up, the origin is on the floor")
    unmet = [f"not as asked for: {world[key]}" for key in _UNMET if world[key]]
    details = [
        *unmet,
        *map(_describe_cue, world["cues"]),
        *map(_describe_landmark, world["landmarks"]),
    ]
    return [f"world: {'; '.join(said)}", *(f"  {line}" for line in details)]


def _describe_unit(world: Mapping[str, Any]) -> str:
    """Return what lengths are in, and how sure that is."""
    if world["unit"] == ARBITRARY:
        return _UNIT_OF_FILE if world["kind"] == "file" else _NOT_SCALED
    sigma = world["scale_sigma_percent"]
    sure = "" if sigma is None else f", uncertain by {sigma:.1f} %, a standard deviation"
    return f"lengths are in {world['unit']}{sure}"


def _describe_cue(cue: Mapping[str, Any]) -> str:
    """Return what a known length is by all of them; of a single one there is nothing to compare."""
    if cue["residual"] is None:
        return f"{cue['cue']}: {cue['metres']:g} m"
    return (
        f"{cue['cue']}: {cue['metres']:g} m, {cue['measured']:.4g} m by all cues "
        f"({cue['residual']:+.1f} sigma)"
    )


def _describe_landmark(landmark: Mapping[str, Any]) -> str:
    """Return how far a landmark is from its place."""
    away = landmark["distance_m"]
    if away is None:
        return f"landmark {landmark['name']}: not used, two cameras that agree on it are needed"
    return f"landmark {landmark['name']}: {1e3 * away:.0f} mm from its place"
