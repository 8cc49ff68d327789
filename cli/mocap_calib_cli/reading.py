"""How keypoints were read, as run.json keeps it, so that a report can read them again."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from mocap_calib_cli.options import KEYPOINTS, SharedOptions

_KEPT = (*KEYPOINTS, "skeleton", "model")
_OF_INTRINSICS = ("rotated", "resized", "exchanged")  # the cameras of results have these already


def describe_reading(shared: SharedOptions) -> dict[str, Any]:
    """Return the options that say how keypoints are read, those that were typed alone."""
    typed = {name: value for name, value in _typed(shared).items() if name in _KEPT}
    return {name: str(value) if isinstance(value, Path) else value for name, value in typed.items()}


def options_of_reading(reading: Mapping[str, Any], shared: SharedOptions) -> SharedOptions:
    """Return the options with which a run read its keypoints; those typed now count more.

    reading: as run.json has it. What no option can be is left out.
    """
    default = SharedOptions()
    kept: dict[str, Any] = {}
    for name, value in reading.items():
        if name not in _KEPT or name in _OF_INTRINSICS:
            continue
        several = isinstance(getattr(default, name), tuple)
        if several and isinstance(value, list):
            kept[name] = tuple(map(str, value))
        elif not several and isinstance(value, str):
            kept[name] = Path(value) if name == "skeleton" else value
    typed = {name: value for name, value in _typed(shared).items() if name in _KEPT}
    return replace(default, **{**kept, **typed})


def _typed(shared: SharedOptions) -> dict[str, Any]:
    """Return the options that are not as if left out."""
    default = SharedOptions()
    values = {each.name: getattr(shared, each.name) for each in fields(SharedOptions)}
    return {name: value for name, value in values.items() if value != getattr(default, name)}
