"""Kernels run where numba is, and their numpy definitions elsewhere."""

import sys

import pytest

from mocap_calib.compute import kernels


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
    monkeypatch.delitem(sys.modules, "mocap_calib.compute.jit", raising=False)
    monkeypatch.setitem(sys.modules, "numba", None)
    assert not kernels.kernels_at_hand()
    assert kernels.compiled("mocap_calib.any_kernels") is None
    assert kernels.compile_ahead() == []
