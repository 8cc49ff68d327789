"""Write rows of numbers as comma-separated text, compiled: each as `repr` writes it.

The shortest digits that mean a number, and no other, are found by Schubfach (Giulietti, The
Schubfach way to render doubles, 2020).
"""

import numpy as np

from mocap_calib.kernels.jit import changed_octets, inlined, ints, kernel, octets
from mocap_calib.types import Ints, Octets

NUMBER = 25  # characters of a number and a comma, at most
_COMMA, _LINE_FEED, _POINT, _PLUS, _MINUS, _ZERO = map(ord, ",\n.+-0")
_SMALL_E, _SMALL_I, _SMALL_N, _SMALL_F = map(ord, "einf")
_LEAST, _LARGEST = -292, 324  # powers of ten
_FRACTION = 52  # bits of a number's fraction
_BIAS = 1075  # of its exponent, as a whole number times a power of two
_NO_NUMBER = 0x7FF  # the exponent of NaN and infinity
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_NONE, _ONE, _TWO, _FOUR, _TEN, _HUNDRED = map(np.uint64, (0, 1, 2, 4, 10, 100))
_LEAST_OF_17, _LEAST_OF_20 = np.uint64(10**16), np.uint64(10**19)


def _powers_of_ten() -> Ints:
    """Return `[power, 2]` the upper 128 bits of the powers of ten from -292 to 324, rounded up.

    As two halves of 64 bits each, the upper one first; they are unsigned.
    """
    halves = []
    for power in range(_LEAST, _LARGEST + 1):
        shift = 127 - _floor_log2(power)
        above, below = 10 ** max(power, 0) << max(shift, 0), 10 ** max(-power, 0)
        below <<= max(-shift, 0)
        bits = -(-above // below)
        halves.append((bits >> 64, bits & (1 << 64) - 1))
    return np.array(halves, dtype=np.uint64).view(np.int64)


def _floor_log2(power: int) -> int:
    """Return the whole part of the logarithm of ten to a power to the base of two."""
    return power * 1741647 >> 19


POWERS = _powers_of_ten()


@inlined
def _high_product(first: np.uint64, second: np.uint64) -> np.uint64:
    """Return the upper 64 bits of the product of two numbers."""
    first_low, first_high = first & _LOW, first >> _HALF
    second_low, second_high = second & _LOW, second >> _HALF
    low = first_low * second_low
    middle = first_high * second_low + (low >> _HALF)
    other = first_low * second_high + (middle & _LOW)
    return first_high * second_high + (middle >> _HALF) + (other >> _HALF)


@inlined
def _round_to_odd(high: np.uint64, low: np.uint64, factor: np.uint64) -> np.uint64:
    """Return a product with a power of ten without its lower 128 bits; odd where they count."""
    carried = _high_product(low, factor)
    middle = high * factor + carried
    whole = _high_product(high, factor)
    if middle < carried:
        whole += _ONE
    if middle > _ONE:
        whole |= _ONE
    return whole


@inlined
def _shortest(fraction: np.uint64, exponent: int, powers: Ints) -> tuple[np.uint64, int]:
    """Return the digits, as a whole number, and the power of ten that they are times."""
    mantissa = fraction | (_ONE << np.uint64(_FRACTION)) if exponent else fraction
    two = max(exponent, 1) - _BIAS
    if -_FRACTION <= two <= 0:
        dropped = np.uint64(-two)
        if mantissa & ((_ONE << dropped) - _ONE) == _NONE:
            return mantissa >> dropped, 0
    closer = fraction == _NONE and exponent > 1  # the next smaller number is nearer
    ten = (two * 1262611 - (524031 if closer else 0)) >> 22
    shift = np.uint64(two + (-ten * 1741647 >> 19) + 1)
    high = np.uint64(powers[-ten - _LEAST, 0])
    low = np.uint64(powers[-ten - _LEAST, 1])
    four = _FOUR * mantissa
    lower = _round_to_odd(high, low, (four - (_ONE if closer else _TWO)) << shift)
    value = _round_to_odd(high, low, four << shift)
    upper = _round_to_odd(high, low, (four + _TWO) << shift)
    if mantissa & _ONE:  # an odd number is not what its bounds are read as
        lower += _ONE
        upper -= _ONE
    short = value >> _TWO
    tens = short // _TEN
    if short >= _TEN:
        below = lower <= tens * np.uint64(40)
        above = tens * np.uint64(40) + np.uint64(40) <= upper
        if below != above:
            return (tens + _ONE if above else tens), ten + 1
    below = lower <= _FOUR * short
    above = _FOUR * short + _FOUR <= upper
    if below != above:
        return (short + _ONE if above else short), ten
    middle = _FOUR * short + _TWO
    up = value > middle or (value == middle and short & _ONE != _NONE)
    return (short + _ONE if up else short), ten


@inlined
def _write_whole(value: np.uint64, count: int, text: Octets, at: int) -> None:
    """Write a number of so many digits, two at a time from the last."""
    place = at + count - 1
    while place > at:
        rest = value // _HUNDRED
        two = np.uint32(value - _HUNDRED * rest)
        ten = two // np.uint32(10)
        text[place - 1] = _ZERO + ten
        text[place] = _ZERO + (two - np.uint32(10) * ten)
        value = rest
        place -= 2
    if place == at:
        text[at] = _ZERO + np.int64(value)


@inlined
def _count_digits(value: np.uint64, most: int, bound: np.uint64) -> int:
    """Return how many digits a number has, at most so many; bound: the least that has as many."""
    count = most
    while value < bound and count > 1:
        bound //= _TEN
        count -= 1
    return count


@inlined
def _write_int(value: int, text: Octets, at: int) -> int:
    """Write a whole number; return where it ends."""
    if value < 0:
        text[at] = _MINUS
        at += 1
    size = np.uint64(abs(value))
    count = _count_digits(size, 20, _LEAST_OF_20)
    _write_whole(size, count, text, at)
    return at + count


@inlined
def _write_zeros(text: Octets, at: int, end: int) -> None:
    """Write zeros from a place up to another."""
    for place in range(at, end):
        text[place] = _ZERO


@inlined
def _write_number(digits: np.uint64, count: int, before: int, text: Octets, at: int) -> int:
    """Write so many digits, some of them before the point; return where they end."""
    if before <= 0:
        first = at + 2 - before
        _write_zeros(text, at, first)
        text[at + 1] = _POINT
        _write_whole(digits, count, text, first)
        return first + count
    if before >= count:
        _write_whole(digits, count, text, at)
        _write_zeros(text, at + count, at + before + 2)
        text[at + before] = _POINT
        return at + before + 2
    _write_whole(digits, count, text, at + 1)
    for place in range(at, at + before):
        text[place] = text[place + 1]
    text[at + before] = _POINT
    return at + count + 1


@inlined
def _write_with_exponent(digits: np.uint64, count: int, before: int, text: Octets, at: int) -> int:
    """Write so many digits, some of them before the point, as a number from 1 to 10."""
    _write_whole(digits, count, text, at + 1)
    text[at] = text[at + 1]
    text[at + 1] = _POINT
    at += count + 1 if count > 1 else 1
    text[at] = _SMALL_E
    text[at + 1] = _MINUS if before < 1 else _PLUS
    power = abs(before - 1)
    count = 2 if power < 100 else 3
    _write_whole(np.uint64(power), count, text, at + 2)
    return at + 2 + count


@inlined
def _write_float(cell: int, powers: Ints, text: Octets, at: int) -> int:
    """Write a float of these 64 bits, nothing for NaN; return where it ends."""
    exponent = int(cell >> _FRACTION & _NO_NUMBER)
    fraction = np.uint64(cell) & ((_ONE << np.uint64(_FRACTION)) - _ONE)
    if exponent == _NO_NUMBER and fraction != _NONE:
        return at
    if cell < 0:
        text[at] = _MINUS
        at += 1
    if exponent == _NO_NUMBER:
        text[at], text[at + 1], text[at + 2] = _SMALL_I, _SMALL_N, _SMALL_F
        return at + 3
    if exponent == 0 and fraction == _NONE:
        return _write_number(_NONE, 1, 1, text, at)
    digits, ten = _shortest(fraction, exponent, powers)
    while digits % _TEN == _NONE:
        digits //= _TEN
        ten += 1
    count = _count_digits(digits, 17, _LEAST_OF_17)
    if -4 < count + ten <= 16:
        return _write_number(digits, count, count + ten, text, at)
    return _write_with_exponent(digits, count, count + ten, text, at)


@inlined
def _write_text(octets: Octets, text: Octets, at: int) -> int:
    """Write a text; return where it ends."""
    for n in range(len(octets)):
        text[at + n] = octets[n]
    return at + len(octets)


@kernel(octets(1), ints(2), ints(2), octets(1), ints(2), changed_octets(1))
def write_rows(
    first: Octets, cells: Ints, powers: Ints, last: Octets, numbers: Ints, text: Octets
) -> int:
    """Write lines: a text, floats, another text, whole numbers; with commas between the numbers.

    cells: `[row, column]` the floats' 64 bits each. powers: `POWERS`. numbers: `[row, column]`.
    text: room for `NUMBER` characters of each number, the texts and a line feed. Returns where the
    last line ends.
    """
    at = 0
    for row in range(len(cells)):
        at = _write_text(first, text, at)
        for column in range(cells.shape[1]):
            if column:
                text[at] = _COMMA
                at += 1
            at = _write_float(cells[row, column], powers, text, at)
        at = _write_text(last, text, at)
        for column in range(numbers.shape[1]):
            if column:
                text[at] = _COMMA
                at += 1
            at = _write_int(numbers[row, column], text, at)
        text[at] = _LINE_FEED
        at += 1
    return at
