"""Zeros without a sign, for files that people read."""

from collections.abc import Mapping
from typing import Any

import numpy as np


def unsigned_zeros(value: Any) -> Any:
    """Return nested mappings, lists and numbers in which -0.0 is 0.0; arrays become lists.

    The sign of a zero is left over from a product or a rounding, and says nothing.
    """
    if isinstance(value, np.ndarray):
        return (value + 0.0).tolist()
    if isinstance(value, Mapping):
        return {key: unsigned_zeros(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [unsigned_zeros(each) for each in value]
    return value + 0.0 if isinstance(value, float) else value
