"""Adjust a rig, and match by it in turns, from one start or from several."""

from dataclasses import replace

import numpy as np

from mocap_calib.adjust.fit import fit_equally_well, measure_fit
from mocap_calib.adjust.problem import choose_problem, free_poses, solve
from mocap_calib.adjust.residuals import State
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config, MatchingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.alignment import with_size_of
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.results import Adjusted, LiftedPoses, Matches
from mocap_calib.rig.associate import associate, have_same_groups, label_single_subject
from mocap_calib.rig.factorization import factorise
from mocap_calib.types import CameraRig, Progress, Sample, silent


def adjust(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> CameraRig:
    """Return the rig that minimises the robust reprojection error of the matched detections.

    Intrinsics stay as they are, and so do the first camera and the size of the rig. It is adjusted
    twice: the loss is in standard deviations of the errors, and how large these are is known only
    of a rig that is close.

    Raises UnderconstrainedCameraError for the camera that has the fewest points, where they are
    too few to constrain it, and DegenerateError where there is no match at all.
    """
    close = adjust_once(sample, rig, matches, config)
    return adjust_once(sample, close, matches, config, already_close=True)


@single_threaded_libraries()
def adjust_once(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    already_close: bool = False,
) -> CameraRig:
    """Return what `adjust` does, by the errors that the rig has to begin with.

    The loss is tightened in steps. already_close: the rig has been adjusted before, so that only
    the last step is needed.
    """
    problem = choose_problem(sample, rig, matches, config, all_detections=not already_close)
    found = solve(
        problem.start(),
        problem.rays,
        free_poses(len(rig)),
        config.adjust,
        already_close=already_close,
    )
    return placed_as(rig, found)


def placed_as(rig: CameraRig, state: State) -> CameraRig:
    """Return the rig with the poses of a state, at the size that it has."""
    adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
    return with_size_of(rig, adjusted)


@single_threaded_libraries()
def adjust_from_best_start(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    lifted: LiftedPoses,
    progress: Progress,
) -> Adjusted:
    """Adjust the averaged rig and, where nothing was lifted, the rigs found by factorization.

    Returns the adjusted rig that fits best, and with it one that fits as well but is another rig:
    the same reversed in depth. Raises DegenerateError where no start can be adjusted.
    """
    found: list[Adjusted] = []
    refusals: list[DegenerateError] = []
    for start, labels in [(rig, matches), *_starts_without_model(sample, lifted, config.matching)]:
        try:
            adjusted = adjust_until_stable(
                sample, start, labels, config, lifted=lifted, progress=progress
            )
        except DegenerateError as error:
            refusals.append(error)
        else:
            found.append(adjusted)
    if not found:
        raise refusals[0]
    return _best_fit(sample, found, config)


@single_threaded_libraries()
def adjust_until_stable(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    lifted: LiftedPoses,
    progress: Progress,
) -> Adjusted:
    """Adjust, match by the adjusted rig, and adjust again until nothing changes.

    It ends when no detection changes its group and no camera turns any more, or after
    `config.adjust.rounds` rounds. Raises DegenerateError where what was matched does not
    constrain the rig.
    """
    rounds = config.adjust.rounds
    for done in range(1, rounds + 1):
        adjusted = adjust_once(sample, rig, matches, config, already_close=done > 1)
        progress("adjust", done, rounds)
        matches_again = associate(sample, lifted, adjusted, config, progress=silent)
        still = _largest_turn_deg(rig, adjusted) < config.adjust.still_deg
        converged = have_same_groups(matches_again, matches) and still
        rig, matches = adjusted, matches_again
        if converged:
            break
    return Adjusted(
        rig=rig,
        matches=matches,
        depth_reversed_rig=None,
        rounds=done,
        converged=converged,
    )


def _starts_without_model(
    sample: Sample, lifted: LiftedPoses, config: MatchingConfig
) -> list[tuple[CameraRig, Matches]]:
    """Return rigs found by factorization with their labels, where no body could be lifted."""
    if np.isfinite(lifted.centre).any():
        return []
    labels = label_single_subject(sample, config.factorization_share)
    if labels is None:
        return []
    return [(rig, labels) for rig in factorise(sample, labels)]


def _best_fit(sample: Sample, adjusted: list[Adjusted], config: Config) -> Adjusted:
    """Return the rig that fits best, with another that fits as well, if there is one.

    The first of those that differ by no more than where an adjustment ends: the smallest change of
    rounding would choose another.
    """
    if len(adjusted) == 1:
        return adjusted[0]
    fits = [measure_fit(sample, each.rig, each.matches, config) for each in adjusted]
    # a rig under which nothing is matched has no misfit: it is taken where no other is
    misfit = np.nan_to_num([fit.misfit for fit in fits], nan=np.inf)
    ranked = np.argsort(misfit, kind="stable").tolist()
    best = int(np.argmax(misfit <= config.uncertainty.tied_misfit * misfit.min()))
    for k in ranked:
        turn_deg = _largest_turn_deg(adjusted[k].rig, adjusted[best].rig)
        another_rig = turn_deg > config.uncertainty.same_rig_deg
        if another_rig and fit_equally_well(fits[k], fits[best], config.uncertainty):
            return replace(adjusted[best], depth_reversed_rig=adjusted[k].rig)
    return adjusted[best]


def _largest_turn_deg(first: CameraRig, second: CameraRig) -> float:
    """Return the largest angle between two rigs' rotations, taken relative to the first camera."""
    from_first = [rig.rotation @ rig.rotation[0].T for rig in (first, second)]
    return float(np.rad2deg(angle_between(*from_first).max()))
