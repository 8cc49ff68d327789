"""What a network computes beside matrix products."""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats32

_ONE, _HALF, _ROOT_HALF = np.float32(1), np.float32(0.5), np.float32(0.5**0.5)
# erf(x) = x P(x^2) / Q(x^2) to 2e-7 where |x| <= 4, and 1 beyond: Eigen 3.4, `generic_fast_erf`
_LARGEST = np.float32(4)
_P0, _Q0 = np.float32(-1.60960333262415e-2), np.float32(-1.42647390514189e-2)
_P1, _Q1 = np.float32(-2.95459980854025e-3), np.float32(-7.37332916720468e-3)
_P2, _Q2 = np.float32(-7.34990630326855e-4), np.float32(-1.68282697438203e-3)
_P3, _Q3 = np.float32(-5.69250639462346e-5), np.float32(-2.13374055278905e-4)
_P4, _Q4 = np.float32(-2.10102402082508e-6), np.float32(-1.45660718464996e-5)
_P5, _P6 = np.float32(2.77068142495902e-8), np.float32(-2.72614225801306e-10)


@inlined
def _activate_row(values: Floats32, bias: Floats32) -> None:
    """Set values `[K]` to x Phi(x) = (x + |x| - |x| (1 - erf(|x| / sqrt(2)))) / 2."""
    for k in range(len(values)):
        x = values[k] + bias[k]
        size = abs(x)
        y = size * _ROOT_HALF
        y = y if y < _LARGEST else _LARGEST
        z = y * y
        p = (((((_P6 * z + _P5) * z + _P4) * z + _P3) * z + _P2) * z + _P1) * z + _P0
        q = (((_Q4 * z + _Q3) * z + _Q2) * z + _Q1) * z + _Q0
        values[k] = _HALF * (x + size - size * (_ONE - y * p / q))


@kernel("f4[:,::1], f4[::1]")
def activate(values: Floats32, bias: Floats32) -> None:
    """Set values `[N, K]` to x Phi(x), x = value + bias `[K]`."""
    for n in range(len(values)):
        _activate_row(values[n], bias)
