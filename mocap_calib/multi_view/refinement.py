"""Rounds of adjusting the rig and matching by it, from one start or several."""

import numpy as np

from mocap_calib.config import SAME_RIG_DEG, Config
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.multi_view.association import associate, same_groups, single_subject
from mocap_calib.multi_view.bundle_adjustment import adjust
from mocap_calib.multi_view.factorization import factorise
from mocap_calib.multi_view.uncertainty import fit_equally_well, measure_fit
from mocap_calib.types import (
    Adjusted,
    CameraRig,
    LiftedPoses,
    Matches,
    Progress,
    Sample,
    silent,
)


def adjust_from_best_start(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    progress: Progress,
) -> Adjusted:
    """Adjust the averaged rig; where no model helped, also rigs found by factorization.

    Returns the adjusted rig that fits best, and with it the one that fits as well but is reversed
    in depth, if there is one. Raises DegenerateError where no start can be adjusted.
    """
    found: list[Adjusted] = []
    refusals: list[DegenerateError] = []
    for start, labels in [(rig, matches), *_starts_without_model(sample, lifted)]:
        try:
            found.append(
                adjust_until_stable(sample, lifted, start, labels, config, progress=progress)
            )
        except DegenerateError as error:
            refusals.append(error)
    if not found:
        raise refusals[0]
    return _best(sample, found, config)


def adjust_until_stable(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    progress: Progress,
) -> Adjusted:
    """Adjust, match by the adjusted rig, and adjust again until nothing changes.

    It ends when no detection changes its group and no camera turns any more, or after
    `config.adjust.rounds` rounds.
    """
    rounds = config.adjust.rounds
    for done in range(1, rounds + 1):
        before, labels = rig, matches
        rig = adjust(
            sample, before, labels, config.adjust, config.triangulate, already_close=done > 1
        )
        progress("adjust", done, rounds)
        matches = associate(sample, lifted, rig, config, progress=silent)
        still = _largest_turn_deg(before, rig) < config.adjust.still_deg
        converged = same_groups(matches, labels) and still
        if converged:
            break
    return Adjusted(rig, matches, None, done, converged)


def _starts_without_model(sample: Sample, lifted: LiftedPoses) -> list[tuple[CameraRig, Matches]]:
    """Return rigs found by factorization with their labels, where no body could be lifted."""
    if np.isfinite(lifted.centre).any():
        return []
    labels = single_subject(sample)
    return [] if labels is None else [(rig, labels) for rig in factorise(sample, labels)]


def _best(sample: Sample, found: list[Adjusted], config: Config) -> Adjusted:
    """Return the rig that fits best, with the one that fits as well and stands differently."""
    fits = [measure_fit(sample, each.rig, each.matches, config.triangulate) for each in found]
    best, *others = sorted(range(len(found)), key=lambda k: fits[k].misfit)
    rig = found[best].rig
    for k in others:
        other = found[k].rig
        if fit_equally_well(fits[k], fits[best]) and _largest_turn_deg(other, rig) > SAME_RIG_DEG:
            return Adjusted(
                rig=rig,
                matches=found[best].matches,
                depth_reversed_rig=other,
                rounds=found[best].rounds,
                converged=found[best].converged,
            )
    return found[best]


def _largest_turn_deg(first: CameraRig, second: CameraRig) -> float:
    """Return the largest angle between two rigs' rotations against their first camera."""
    turned = angle_between(*(rig.rotation @ rig.rotation[0].T for rig in (first, second)))
    return float(np.rad2deg(turned.max()))
