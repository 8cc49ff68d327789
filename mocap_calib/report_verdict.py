"""What run.json says of how far a rig and its cameras can be trusted."""

from typing import Any

import numpy as np

from mocap_calib.multi_view.evaluation import median_and_max
from mocap_calib.types import ARBITRARY, Check, GroupResult


def describe_verdict(group: GroupResult) -> dict[str, Any]:
    """Return whether the recording determines the rig, and what it leaves open."""
    uncertainty = group.uncertainty
    reversal = group.adjusted.depth_reversed_rig is not None
    return {
        "rig": group.verdict,
        "reasons": list(group.reasons),
        "rotation_sigma_deg": median_and_max(np.degrees(uncertainty.covariance.rotation_sigma)),
        "centre_sigma_percent": median_and_max(100 * uncertainty.covariance.centre_sigma),
        "intrinsics_turn_deg": median_and_max(np.degrees(uncertainty.intrinsics_turn)),
        "checks": [_describe_check(check) for check in group.checks],
        "reversal": "not observable" if reversal else "none found",
        "translation": "not observable" if uncertainty.weak_perspective.any() else "observed",
    }


def describe_sigma(group: GroupResult, views: list[int]) -> dict[str, float | None]:
    """Return how far a camera may be off: its rotation, and its place after the best similarity.

    views: indices of the camera's; where it was moved, it has several, and the largest counts.
    """
    covariance = group.uncertainty.covariance
    centre = float(covariance.centre_sigma[views].max())
    return {
        "rotation_sigma_deg": float(np.degrees(covariance.rotation_sigma[views].max())),
        "centre_sigma_percent": 100 * centre,
        "centre_sigma": None if group.rig.unit == ARBITRARY else centre * covariance.size,
        "intrinsics_turn_deg": float(np.degrees(group.uncertainty.intrinsics_turn[views].max())),
    }


def _describe_check(check: Check) -> dict[str, Any]:
    """Return what a check found, and whether that is what sound recordings show."""
    return {
        "name": check.name,
        "value": finite_or_none(check.value),
        "limit": check.limit,
        "camera": check.camera or None,
        "passed": check.passed,
    }


def finite_or_none(value: float) -> float | None:
    """Return the value, or None where it is not known."""
    return float(value) if np.isfinite(value) else None
