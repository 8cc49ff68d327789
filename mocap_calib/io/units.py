"""Units of length: what files say, and from one to another."""

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import malformed

ARBITRARY = "arbitrary"
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def unit_factor(source: str, target: str, owner: str) -> float:
    """What a length in `source` is multiplied by to be in `target`; `owner` names who asks for it.

    Raises MismatchError where one of them is no unit of length.
    """
    if source == target:
        return 1.0
    for unit in (source, target):
        if unit not in METRES:
            found = "an arbitrary unit" if unit == ARBITRARY else f"the unit {unit!r}"
            raise MismatchError(
                f"{owner}: expected lengths in {' or '.join(METRES)}, found {found}; say what a length of 1 is with `mocap-calib convert --unit`"
            )
    # the quotient of the powers of ten is exact this way round
    return (
        METRES[source] / METRES[target]
        if METRES[source] >= METRES[target]
        else 1 / round(METRES[target] / METRES[source])
    )


def known_unit(unit: str, source: str) -> str:
    """The unit as it is spelt here (`millimeters` -> `mm`). Raises FormatError for what is no unit of length."""
    spelt = unit.strip().lower()
    for short, words in {
        "m": ("m", "metre", "meter"),
        "cm": ("cm", "centimetre", "centimeter"),
        "mm": ("mm", "millimetre", "millimeter"),
    }.items():
        if spelt in words or spelt.removesuffix("s") in words[1:]:
            return short
    if spelt in (ARBITRARY, ""):
        return ARBITRARY
    raise malformed(
        source,
        f"a unit of length ({', '.join(METRES)} or {ARBITRARY})",
        repr(unit),
        "write one of these",
    )
