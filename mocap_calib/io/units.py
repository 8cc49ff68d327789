"""Units of length: what files say, and from one to another."""

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.types import ARBITRARY, METRES

__all__ = ["ARBITRARY", "METRES", "known_unit", "refuse_unit", "unit_factor"]

_WORDS = {
    "m": ("metre", "meter"),
    "cm": ("centimetre", "centimeter"),
    "mm": ("millimetre", "millimeter"),
}


def unit_factor(source: str, target: str, owner: str) -> float:
    """Return what a length in `source` is multiplied by to be in `target`.

    owner: names who asks for it.

    Raises MismatchError where one of them is no unit of length.
    """
    if source == target:
        return 1.0
    for unit in (source, target):
        if unit not in METRES:
            found = "an arbitrary unit" if unit == ARBITRARY else f"the unit {unit!r}"
            raise MismatchError(
                owner,
                f"lengths in {' or '.join(METRES)}",
                found,
                "a known length sets the scale of a run (`mocap-calib scale OUT --height 1.75`), "
                "of other files `convert --input-unit m` says the unit, in Python scale(1, 'm')",
            )
    # the quotient of the powers of ten is exact this way round
    if METRES[source] >= METRES[target]:
        return METRES[source] / METRES[target]
    return 1 / round(METRES[target] / METRES[source])


def known_unit(unit: str, source: str) -> str:
    """Return the unit as it is spelt here (`millimeters` -> `mm`), "arbitrary" where it is empty.

    Raises FormatError for what is no unit of length.
    """
    spelt = unit.strip().lower()
    if spelt in (ARBITRARY, ""):
        return ARBITRARY
    for short, words in _WORDS.items():
        if spelt == short or spelt in words or spelt.removesuffix("s") in words:
            return short
    expected = f"a unit of length ({', '.join(METRES)} or {ARBITRARY})"
    raise FormatError(source, expected, repr(unit), "write one of these")


def refuse_unit(source: str, unit: str) -> MismatchError:
    """Return the complaint about a unit that is said of lengths which a file calls arbitrary."""
    return MismatchError(
        source,
        "a file that leaves its unit open",
        f"lengths that were never scaled, which are not in {unit}",
        "set the scale by a known length: `mocap-calib scale OUT --height 1.75` "
        "(or --length, --camera-distance)",
    )
