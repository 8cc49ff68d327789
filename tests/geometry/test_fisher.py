"""Fisher's distribution beside scipy's."""

import pytest
from scipy.special import chdtri, fdtri

from mocap_calib.geometry.fisher import fisher_quantile, fisher_share
from mocap_calib.multi_view.rig_covariance import _WITHIN_95


@pytest.mark.parametrize("below", [0.5, 2.0, 4.0, 5.7, 33.3, 400.0, 10_000.0])
@pytest.mark.parametrize("above", [3.0, 6.0])
def test_quantiles_are_those_of_scipy(above, below):
    """To 1e-10 (measured 1.2e-11), and the share under each is the one that was asked for."""
    for share in (0.05, 0.5, 0.95):
        found = fisher_quantile(share, above, below)
        assert found == pytest.approx(fdtri(above, below, share), rel=1e-10)
        assert fisher_share(found, above, below) == pytest.approx(share, rel=1e-10)


def test_the_limit_for_many_degrees_of_freedom_is_that_of_scipy():
    assert pytest.approx(chdtri(3, 0.05), rel=1e-14) == _WITHIN_95
