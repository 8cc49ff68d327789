"""What was written of a run, and what of all that was asked for could not be had."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mocap_calib.errors import MismatchError
from mocap_calib.types import ARBITRARY


@dataclass(frozen=True)
class WrittenGroup:
    """What was written of a group of cameras.

    report: what `run.json` holds.
    notes: a line for each further format: what it does not hold.
    refused: further formats that were not written, as they cannot hold the group, and why.
    """

    report: dict[str, Any]
    notes: tuple[str, ...]
    refused: Mapping[str, MismatchError]

    @property
    def complaint(self) -> MismatchError | None:
        """What was asked for of this group and could not be had, None where all was."""
        return complain(self.report, self.refused)


def complain(
    report: Mapping[str, Any], refused: Mapping[str, MismatchError]
) -> MismatchError | None:
    """Return an error that says what was asked for and could not be had, though the rest was.

    report: what `run.json` holds. refused: further formats that were not written.
    """
    world = report["world"]
    unmet = [world[key] for key in ("axes_unmet", "scale_unmet") if world[key]]
    if not unmet:
        return next(iter(refused.values()), None)
    how = []
    if world["axes_unmet"]:
        on_floor = world["kind"] == "floor"
        how.append("on the floor" if on_floor else f"in the axes of camera {world['camera']}")
    if world["unit"] == ARBITRARY:
        how.append("with arbitrary lengths (`mocap-calib scale OUT --height 1.75` sets the scale)")
    but = f" but {', '.join(refused)}" if refused else ""
    said = " ".join(["; ".join(unmet) + f"; all files{but} are written", *how])
    return MismatchError(said)
