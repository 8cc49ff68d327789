"""TOML that is written: every float with the digits that bring it back exactly, no zero signed."""

from collections.abc import Mapping
from typing import Any

import tomli_w

from mocap_calib.io.zeros import unsigned_zeros


def dump_toml(document: Mapping[str, Any]) -> str:
    """Return a document as TOML: of each table its values first, then the tables in it.

    TOML has no null: fields and entries that are None are left out.
    """
    return tomli_w.dumps(_without_none(unsigned_zeros(document)))


def _without_none(value: Any) -> Any:
    """Return the value without the fields and entries that are None, at any depth."""
    if isinstance(value, Mapping):
        return {key: _without_none(each) for key, each in value.items() if each is not None}
    if isinstance(value, list):
        return [_without_none(each) for each in value if each is not None]
    return value
