"""Cameras and 3D poses from the 2D keypoints of moving people and animals.

The names of `__init__.pyi` are the library, as far as most programs need it; docs/python.md shows
them at work. Each is imported when it is first used: `import mocap_calib` itself is quick.
"""

import re
from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.1.0"

_IMPORT = re.compile(r"^    from (\S+) import (\w+) as", re.M)
_NAMES = Path(__file__).with_suffix(".pyi").read_text("utf-8")
_MODULE_OF = {name: module for module, name in _IMPORT.findall(_NAMES)}

__all__ = tuple(_MODULE_OF)


def __getattr__(name: str) -> Any:
    """Import a name of `__all__` when it is first used (PEP 562), and `front` before it."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import_module(f"{__name__}.front")  # binds rig.project, result.plot, ...
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names that this module has or can import."""
    return sorted({*globals(), *__all__})
