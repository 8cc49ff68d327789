"""Kernels run where numba is, and their numpy definitions elsewhere."""

import subprocess
import sys

import pytest

from mocap_calib.kernels import loading as kernels


@pytest.fixture(autouse=True)
def no_memory():
    """Forget what was found of numba, before and after."""

    def forget() -> None:
        kernels.kernels_at_hand.cache_clear()
        kernels.compiled.cache_clear()

    forget()
    yield
    forget()


def test_without_numba_nothing_is_compiled(monkeypatch):
    assert kernels.kernels_at_hand()
    kernels.kernels_at_hand.cache_clear()
    monkeypatch.delitem(sys.modules, "mocap_calib.kernels.jit", raising=False)
    monkeypatch.setitem(sys.modules, "numba", None)
    assert not kernels.kernels_at_hand()
    assert kernels.compiled("mocap_calib.any_kernels") is None
    assert kernels.compile_ahead() == []


def test_kernels_are_compiled_without_the_blas_that_products_of_others_find(tmp_path):
    """It takes 0.2 s to import."""
    pytest.importorskip("numba")
    kernel = "from mocap_calib.kernels.jit import FLOAT, kernel\n\n"
    kernel += "@kernel(FLOAT)\ndef twice(x):\n    return 2 * x\n"
    (tmp_path / "new_kernels.py").write_text(kernel, "utf-8")
    code = f"""
import sys
import numpy as np
sys.path.insert(0, {str(tmp_path)!r})
import new_kernels
assert "numba" in sys.modules
assert not {{"scipy.linalg", "scipy.special", "scipy.optimize"}} & set(sys.modules)
import numba
print(numba.njit(lambda a: np.dot(a, a))(2 * np.eye(2))[1, 1])
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.stdout, run.stderr) == ("4.0\n", "")
