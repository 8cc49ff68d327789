"""Parse rows of comma-separated numbers, compiled: as `float` reads each cell, at disk speed.

Only plain rows are parsed. Whatever is odd about one (a quote, a word, a cell too many) ends the
parsing there, and the careful readers say what it is.
"""

from fractions import Fraction

import numpy as np

from mocap_calib.kernels.jit import (
    bools,
    changed_floats,
    changed_ints,
    floats,
    inlined,
    kernel,
    octets,
)
from mocap_calib.types import Bools, Floats, Ints, Octets

_COMMA, _LINE_FEED, _RETURN, _QUOTE, _POINT, _PLUS, _MINUS = map(ord, ',\n\r".+-')
_ZERO, _NINE, _SMALL_E, _LARGE_E = map(ord, "09eE")
_DIGITS = 19  # of a number: what 64 bits hold
_LARGEST = 60  # power of ten
_SPLIT = 2.0**27 + 1.0
_BEYOND = 10_000  # any power of ten that is not parsed
_CERTAIN = 2.0**-96  # relative; the sum of two floats below is right to 2**-101


def powers_of_ten() -> Floats:
    """Return `[power, 2]` each power of ten from -60 to 60 as the sum of two floats."""
    exact = [Fraction(10) ** power for power in range(-_LARGEST, _LARGEST + 1)]
    return np.array([(float(power), float(power - Fraction(float(power)))) for power in exact])


@inlined
def _nearest(mantissa: np.uint64, power: int, powers: Floats) -> float:
    """Return the float that is nearest to `mantissa` times ten to the `power`.

    The product is the sum of two floats (Dekker, A floating-point technique for extending the
    available precision, 1971). NaN where it is so near the middle of two floats that this cannot
    tell which is nearer.
    """
    high = powers[power + _LARGEST, 0]
    low = powers[power + _LARGEST, 1]
    whole = np.float64(mantissa)
    left = np.float64(np.int64(mantissa - np.uint64(whole)))
    product = whole * high
    shifted = _SPLIT * whole
    whole_1 = shifted - (shifted - whole)
    whole_2 = whole - whole_1
    shifted = _SPLIT * high
    high_1 = shifted - (shifted - high)
    high_2 = high - high_1
    error = whole_1 * high_1 - product
    error = error + whole_1 * high_2 + whole_2 * high_1 + whole_2 * high_2
    error += whole * low + left * high
    result = product + error
    error -= result - product
    doubt = _CERTAIN * result
    if result + (error - doubt) == result and result + (error + doubt) == result:
        return result
    return np.nan


@inlined
def _exponent(text: Octets, at: int) -> tuple[int, int]:
    """Return the exponent that stands at a place, and where it ends: there where none stands."""
    first = at + (text[at] == _MINUS or text[at] == _PLUS)
    end = first
    exponent = 0
    while _ZERO <= text[end] <= _NINE:
        exponent = min(10 * exponent + text[end] - _ZERO, _BEYOND)
        end += 1
    if end == first:
        return 0, at
    return (-exponent if text[at] == _MINUS else exponent), end


@inlined
def _number(text: Octets, at: int, powers: Floats) -> tuple[float, int]:
    """Return the number that begins at a place, NaN where the cell is empty, and where it ends.

    The end is -1 where it is no plain number.
    """
    begin = at
    at += text[begin] == _MINUS
    first = at
    mantissa = np.uint64(0)
    while _ZERO <= text[at] <= _NINE:
        mantissa = mantissa * np.uint64(10) + np.uint64(text[at] - _ZERO)
        at += 1
    power = at
    if text[at] == _POINT and at > first:
        at += 1
        power = at
        while _ZERO <= text[at] <= _NINE:
            mantissa = mantissa * np.uint64(10) + np.uint64(text[at] - _ZERO)
            at += 1
    power -= at
    if at == first:
        return np.nan, (at if at == begin else -1)
    digits = at - first - (power < 0)  # beside the point
    if text[at] == _SMALL_E or text[at] == _LARGE_E:
        exponent, end = _exponent(text, at + 1)
        if end == at + 1:
            return np.nan, -1
        power += exponent
        at = end
    while digits > _DIGITS and (text[first] == _ZERO or text[first] == _POINT):
        digits -= text[first] == _ZERO
        first += 1
    if digits > _DIGITS or abs(power) > _LARGEST:
        return np.nan, -1
    result = _nearest(mantissa, power, powers)
    if np.isnan(result):
        return result, -1
    return (-result if text[begin] == _MINUS else result), at


@kernel(octets(1), bools(1), floats(2), changed_floats(2), changed_ints(3))
def parse_rows(text: Octets, is_number: Bools, powers: Floats, values: Floats, places: Ints) -> int:
    """Parse rows of text, and return how many are plain, up to the first that is not.

    text: `[octet]`; it ends with the end of a line.
    is_number: `[cell]` whether the cells of a row are numbers; the others are texts.
    powers: `[power, 2]` of `powers_of_ten`.
    values: `[row, number]` become the numbers, NaN where a cell is empty.
    places: `[row, text, 2]` become where in `text` the texts begin and end.
    """
    at = 0
    last = len(is_number) - 1
    for row in range(len(values)):
        numbers = 0
        for cell in range(len(is_number)):
            begin = at
            if is_number[cell]:
                values[row, numbers], at = _number(text, at, powers)
                numbers += 1
                if at < 0:
                    return row
            else:
                while text[at] not in (_COMMA, _LINE_FEED, _RETURN, _QUOTE):
                    at += 1
                places[row, cell - numbers, 0] = begin
                places[row, cell - numbers, 1] = at
            if cell < last:
                if text[at] != _COMMA:
                    return row
                at += 1
        at += text[at] == _RETURN
        if text[at] != _LINE_FEED:
            return row
        at += 1
    return len(values)
