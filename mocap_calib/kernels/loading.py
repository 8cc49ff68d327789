"""Arrays as kernels take them; all kernels compiled ahead."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def contiguous(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return arrays in C order that can be written; those that are so already as they are."""
    return tuple(np.require(array, requirements=("C", "W")) for array in arrays)


def compile_ahead() -> list[str]:
    """Compile all kernels, so that no run waits for them, and return their modules."""
    names = sorted(file.stem for file in Path(__file__).parent.glob("[!_]*.py"))
    for name in names:
        import_module(f"{__package__}.{name}")
    return names
