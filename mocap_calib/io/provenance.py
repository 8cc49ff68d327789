"""What a result file says of how it came about, and of how far its cameras can be trusted."""

import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import takewhile
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from mocap_calib import __version__
from mocap_calib.errors import MismatchError
from mocap_calib.results import VERDICTS, VerdictWord

_Size = Annotated[float, Meta(ge=0, le=sys.float_info.max)]
_Line = Annotated[str, Meta(pattern=r"^[^\x00-\x1f\x7f-\x9f]*$", max_length=1000)]

CAMERA_SIGMAS = ("rotation_sigma_deg", "centre_sigma_percent")
# what a provenance says of the cameras beside it, and a conversion hands on: whether they were
# adjusted, the verdict and what explains it, the error of the points in pixels, the first and last
# frame that they hold for (where a camera was moved), and by the names of cameras how far these may
# be off
_JUDGEMENT: Mapping[str, Any] = {
    "adjusted": bool,
    "verdict": VerdictWord,
    "remarks": list[_Line],
    "reprojection_error_px": _Size,
    "frames": Annotated[list[int], Meta(min_length=2, max_length=2)],
    **dict.fromkeys(CAMERA_SIGMAS, dict[str, _Size]),
}
_ADVICE = {
    "usable": ": read the reasons; it may be too little for angles of joints",
    "weak": ": check it before you measure with it",
    "not determined": ": do not measure with it",
}
_SAYS = "mocap-calib: this rig is "  # before the verdict, in comments; remarks follow, indented
_INDENT = "  "


def provenance(command: str, **fields: Any) -> Mapping[str, Any]:
    """Return the command, the version, and further fields (seed, hashes of the inputs, ...)."""
    return {"command": f"mocap-calib {command}", "version": __version__, **fields}


def plain_fields(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields in the types that every format knows; paths and the like become text."""
    plain: dict[str, Any] = json.loads(json.dumps(provenance, default=str))
    return plain


def judgement(
    verdict: str,
    remarks: Iterable[str],
    reprojection_error_px: float | None,
    **sigmas: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the fields of a provenance that say how far adjusted cameras can be trusted.

    verdict: one of `results.VERDICTS`.
    remarks: what explains the verdict, a line each.
    reprojection_error_px: of the points, None where it is not known.
    sigmas: rotation_sigma_deg and centre_sigma_percent by the names of cameras: how far each may be
        off, a standard deviation; centres in percent of the size of the rig.
    """
    fields = {"adjusted": True, "verdict": verdict, "remarks": list(remarks), **sigmas}
    if reprojection_error_px is not None:
        fields["reprojection_error_px"] = reprojection_error_px
    return fields


def round_sigma(value: float) -> float:
    """Return a standard deviation as files say it, to three digits."""
    return float(f"{value:.3g}")


def hold_for(fields: Mapping[str, Any], frames: Sequence[int], *more: str) -> dict[str, Any]:
    """Return the fields of a provenance with the frames that its cameras hold for, and a remark.

    frames: first and last number. more: further remarks, before those of the fields.
    """
    remarks = [f"holds for the frames {frames[0]} to {frames[1]}", *more]
    return {**fields, "frames": list(frames), "remarks": remarks + fields.get("remarks", [])}


def advice_on(verdict: str) -> str:
    """Return what a verdict means for the use of a rig, to go on with after it; may be empty.

    verdict: one of `results.VERDICTS`.
    """
    return _ADVICE.get(verdict, "")


def read_judgement(stored: Any) -> dict[str, Any]:
    """Return the fields of `judgement` that the provenance in a file has.

    What was edited into something else is left out.
    """
    found: dict[str, Any] = {}
    for key, kind in _JUDGEMENT.items() if isinstance(stored, Mapping) else ():
        with suppress(LookupError, msgspec.ValidationError):
            found[key] = msgspec.convert(stored[key], kind)
    return found


def describe_judgement(fields: Mapping[str, Any]) -> list[str]:
    """Return lines of text for the cameras that a provenance is of; none where nobody judged."""
    verdict = fields.get("verdict")
    if verdict is None:
        return []
    return [
        f"{_SAYS}{verdict}{advice_on(verdict)}",
        *(_INDENT + remark for remark in fields.get("remarks", [])),
    ]


def read_description(lines: Sequence[str]) -> dict[str, Any]:
    """Return the fields of `judgement` that `describe_judgement` wrote among lines of text.

    The error in pixels stands in a remark alone, rounded. Empty where nothing was written.
    """
    first = next((k for k, line in enumerate(lines) if line.startswith(_SAYS)), None)
    if first is None:
        return {}
    verdict = lines[first].removeprefix(_SAYS).partition(":")[0]
    if verdict not in VERDICTS:
        return {}
    remarks = takewhile(lambda line: line.startswith(_INDENT), lines[first + 1 :])
    said = [line.removeprefix(_INDENT) for line in remarks]
    return read_judgement(judgement(verdict, said, None))


def date_of_making() -> str:
    """Return the date and time in UTC, as 2026-01-31T12:00:00Z.

    SOURCE_DATE_EPOCH (seconds since 1970) stands for the clock where it is set, so that all files
    of a run can be made again to the last byte (reproducible-builds.org).

    Raises MismatchError where it is no such number.
    """
    said = os.environ.get("SOURCE_DATE_EPOCH", "")
    try:
        time = datetime.fromtimestamp(int(said), UTC) if said else datetime.now(UTC)
    except (ValueError, OverflowError, OSError):
        raise MismatchError(
            "SOURCE_DATE_EPOCH", "whole seconds since 1970", f"{said!r}", "mend it or unset it"
        ) from None
    return time.strftime("%Y-%m-%dT%H:%M:%SZ")
