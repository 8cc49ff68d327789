"""Read run.json: what `report`, `scale` and `overlay` need is there, and of its type."""

from pathlib import Path
from typing import Any

import msgspec

from mocap_calib.errors import FormatError
from mocap_calib.io.file import read_bytes

Fields = dict[str, Any]


class _Evidence(msgspec.Struct):
    mended: bool
    option: str | None


class _FaultEvidence(msgspec.Struct):
    mirrored: _Evidence | None = None
    flipped: _Evidence | None = None
    sides: _Evidence | None = None


class _Clock(msgspec.Struct):
    used: bool


class _Sigmas(msgspec.Struct):
    centre_sigma_percent: float | None
    centre_sigma: float | None


class _Camera(_Sigmas):
    name: str
    fault_evidence: _FaultEvidence
    clock: _Clock


class _Group(msgspec.Struct):
    folder: str
    cameras: list[str]


class _Epoch(msgspec.Struct):
    folder: str
    first: int
    last: int
    moved: list[str]


class _Run(msgspec.Struct):
    """What is read of the file; further groups of cameras have no hashes."""

    schema: int
    keypoints: list[str]
    cameras: list[_Camera]
    groups: list[_Group]
    epochs: list[_Epoch]
    pairs: list[_Sigmas]
    inputs: Fields = {}
    outputs: Fields = {}
    reading: Fields = {}


def read_run_json(path: Path, schema: int) -> Fields:
    """Return what run.json holds.

    schema: of this version. Raises FormatError where the file is of another one, or was changed.
    """
    source, remedy = str(path), "run again, with this version"
    try:
        found = msgspec.json.decode(read_bytes(path), type=Fields)
        if found.get("schema", schema) != schema:
            raise FormatError(source, f"`schema` {schema}", found["schema"], remedy)
        msgspec.convert(found, _Run)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise FormatError(source, "what `run` writes", f"an error ({error})", remedy) from None
    return found
