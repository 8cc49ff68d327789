"""Hold what was found of a group of cameras, and how sure it is said to be, against the truth."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from mocap_calib.config import EPOCH_MARK
from mocap_calib.geometry.rotation import angle_between, nearest_rotation, rig_change
from mocap_calib.results import GroupResult
from mocap_calib.types import CameraRig, Floats


def judge_group(group: GroupResult, truth: Sequence[CameraRig]) -> dict[str, Any]:
    """Return the verdict on a group, and errors and sigmas of its cameras.

    truth: rigs of cameras that belong together. Where the group has cameras of several of them, no
    errors are given (`true` is false).
    Angles are in degrees, lengths in percent of the size of the rig; `*_distance` are the squared
    Mahalanobis distances of the errors of a camera (3 degrees of freedom). `pair_deg` is the
    largest angle between relative rotations of two cameras and the true ones.
    """
    covariance = group.uncertainty.covariance
    found: dict[str, Any] = {
        "cameras": list(group.rig.names),
        "verdict": group.verdict,
        "failed": [check.name for check in group.assessment.checks if not check.passed],
        "reasons": list(map(str, group.reasons)),
        "rotation_sigma_deg": np.degrees(covariance.rotation_sigma).tolist(),
        "centre_sigma": (100 * covariance.centre_sigma).tolist(),
        "true": False,
    }
    true = find_truth(group.rig, truth)
    if true is None:
        return found
    error, turn, shift = rig_error(group.rig, true), slice(0, 3), slice(3, 6)
    return found | {
        "true": True,
        "pair_deg": worst_pair_deg(group.rig, true),
        "rotation_deg": np.degrees(norms(error[:, turn])).tolist(),
        "rotation_distance": mahalanobis(error[:, turn], covariance.matrix[:, turn, :, turn]),
        "centre": (100 * norms(error[:, shift])).tolist(),
        "centre_distance": mahalanobis(error[:, shift], covariance.matrix[:, shift, :, shift]),
    }


def find_truth(rig: CameraRig, truth: Sequence[CameraRig]) -> CameraRig | None:
    """Return where the cameras of a rig truly stand; None where they are of several rigs."""
    names = [name.partition(EPOCH_MARK)[0] for name in rig.names]
    for each in truth:
        if set(names) <= set(each.names):
            where = [each.names.index(name) for name in names]
            placed = {"rotation": each.rotation[where], "translation": each.translation[where]}
            return replace(rig, **placed)
    return None


def rig_error(rig: CameraRig, true: CameraRig) -> Floats:
    """Return by how much cameras must be turned and shifted to be right, `[view, 6]`.

    As `rig_change` says. The rigs are first aligned by all of their rotations, which is good where
    the centres are on a line too.
    """
    turn = nearest_rotation(np.einsum("vji,vjk->ik", rig.rotation, true.rotation))
    return rig_change(rig, replace(true, rotation=true.rotation @ turn.T))


def worst_pair_deg(rig: CameraRig, true: CameraRig) -> float:
    """Return the largest angle between relative rotations of two cameras and the true ones."""
    angles = (
        angle_between(rig.relative(a, b)[0], true.relative(a, b)[0])
        for a, b in combinations(range(len(rig.cameras)), 2)
    )
    return float(np.degrees(max(angles)))


def mahalanobis(error: Floats, covariance: Floats) -> list[float]:
    """Return e' C^-1 e of the error `[view, 3]` of each camera.

    covariance: `[view, 3, view, 3]`.
    """
    inverse = np.linalg.pinv(np.einsum("vivj->vij", covariance), hermitian=True)
    return np.einsum("vi,vij,vj->v", error, inverse, error).tolist()


def norms(vectors: Floats) -> Floats:
    """Return the lengths of vectors `[view, 3]`."""
    return np.linalg.norm(vectors, axis=1)
