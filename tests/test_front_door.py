"""`import mocap_calib`: quick, and every name of it there."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mocap_calib

HEAVY = ("numpy", "torch", "scipy", "cv2", "h5py", "yaml")


def test_import_is_quick_and_light():
    """Measured 0.001 s on top of the interpreter; the best of three, as other work may run."""
    code = f"""
import sys, time
start = time.perf_counter()
import mocap_calib
seconds = time.perf_counter() - start
print(seconds, [name for name in {HEAVY} if name in sys.modules])
"""
    best = np.inf
    for _ in range(3):
        said = subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True
        ).stdout
        seconds, _, heavy = said.strip().partition(" ")
        assert heavy == "[]"
        best = min(best, float(seconds))
    assert best < 0.1


@pytest.mark.parametrize("name", mocap_calib.__all__)
def test_every_name_resolves(name):
    value = getattr(mocap_calib, name)
    assert value.__name__ == name
    assert value.__doc__, "what users see first says what it is"
    assert name in dir(mocap_calib)


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(mocap_calib.__file__).read_text("utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imported = {
        (alias.name, node.module.removeprefix("mocap_calib."))
        for node in block.body
        for alias in node.names
    }
    assert imported == set(mocap_calib._MODULE_OF.items())
    assert {name for name, _ in imported} == set(mocap_calib.__all__)


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="has no attribute 'frobnicate'"):
        _ = mocap_calib.frobnicate
