"""What is wrong with the files of single cameras, as a calibration shows it, and mending it.

Faults of several kinds may explain the same errors. Each explanation is tried, and the one with
which a calibration explains most of what was seen counts; where none explains more than the files
as they are, nothing is mended.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import Config, MendConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.faults.exchanged import find_exchanged_cameras
from mocap_calib.faults.moved import find_moved_cameras
from mocap_calib.faults.odd_cameras import find_odd_cameras
from mocap_calib.faults.words import describe
from mocap_calib.recording.corrections import Sides, apply_mends
from mocap_calib.results import CalibrationResult, Fault, FaultWord, Mend
from mocap_calib.rig.observed import Observed
from mocap_calib.types import Recording
from mocap_calib.verdict.explained import explained_share, usual_distance

# what was known before the rigs of a recording were built, and all that was found
Calibrated = tuple[Observed, CalibrationResult]
Calibrate = Callable[[Recording], Calibrated]

# with these no rig fits a camera
_GROSS: tuple[FaultWord, ...] = ("mirrored", "resized")


@dataclass(frozen=True)
class _Explanation:
    """Faults that may explain errors, and what follows from mending them.

    gain: -1 to 1, by how much more of what was seen is explained. calibrated: with the mends.
    """

    faults: tuple[Fault, ...]
    gain: float
    calibrated: Calibrated


def mend_faults(
    recording: Recording, calibrated: Calibrated, calibrate: Calibrate
) -> CalibrationResult:
    """Return what is found of a recording with the faults of its cameras named, and mended.

    Where mending is forbidden the mends are tried all the same, since they tell which of several
    explanations is right; the result stays that of the files as they are.

    recording: as it was handed in. calibrated: what was found of it. calibrate: finds the same of
        a recording that was mended.
    """
    config, as_given = calibrated[1].config.mend, calibrated
    faults: tuple[Fault, ...] = ()
    for _ in range(config.rounds):
        best = _best_explanation(recording, calibrated, faults, calibrate)
        if best is None or best.gain <= _refuting_gain(best.faults, config):
            break
        if best.gain <= 0 and faults:  # nothing is left over that another fault would explain
            break
        if best.gain <= 0 or not config.apply:
            faults += _only_named(best.faults)
            break
        calibrated = best.calibrated
        faults += best.faults
    if faults and all(fault.word == "moved" for fault in faults) and _is_in_vain(calibrated[1]):
        calibrated, faults = as_given, ()
    return replace(calibrated[1], faults=faults)


def _refuting_gain(faults: Sequence[Fault], config: MendConfig) -> float:
    """Return the gain that is too small for faults to be real.

    Images that are mirrored or resized fit no rig, and fit well once they are mended. Other faults
    may hardly harm a calibration.
    """
    if any(fault.word in _GROSS for fault in faults):
        return config.least_gross_gain
    return -config.refuting_loss


def _is_in_vain(result: CalibrationResult) -> bool:
    """Return whether cameras that were moved leave a rig that is not determined all the same.

    Then errors come and go for another reason.
    """
    return result.groups[0].verdict == "not determined"


def find_explanations(
    observed: Observed, result: CalibrationResult, config: Config
) -> tuple[tuple[Fault, ...], ...]:
    """Return faults of cameras that stand out, each of which may explain the same errors.

    observed: what was known before the rigs were built. result: what was found with the files as
        they are.
    """

    def find_moved() -> tuple[Fault, ...]:
        return tuple(
            fault
            for group in result.groups
            for fault in find_moved_cameras(observed, group, config)
        )

    def find_in_files() -> tuple[tuple[Fault, ...], ...]:
        exchanged = tuple(
            fault
            for group in result.groups
            for fault in find_exchanged_cameras(observed, group, config)
        )
        return (exchanged,) if exchanged else find_odd_cameras(observed, result, config)

    return find_moved(), *find_in_files()


def mends_of(faults: Sequence[Fault]) -> tuple[Mend, ...]:
    """Return the mends of faults; one of two cameras counts once."""
    return tuple(dict.fromkeys(fault.mend for fault in faults if fault.mend is not None))


def _best_explanation(
    recording: Recording, calibrated: Calibrated, known: tuple[Fault, ...], calibrate: Calibrate
) -> _Explanation | None:
    """Return the new faults whose mends explain most, None where there are none.

    known: faults that are mended already.
    """
    observed, result = calibrated
    tried: list[tuple[tuple[Fault, ...], Calibrated]] = []
    for found in find_explanations(observed, result, result.config):
        new = _new_faults(found, known)
        if new and not _may_be_in_the_mirror((*known, *new), calibrated[1]):
            tried.append(_calibrate_mended(recording, calibrated, known, new, calibrate))
    if not tried:
        return None
    shares = _explained_shares(recording, [calibrated, *(mended for _, mended in tried)])
    gains = [share - shares[0] for share in shares[1:]]
    margin = result.config.mend.moved_margin
    ranks = [gain - margin * _has_moved(new) for gain, (new, _) in zip(gains, tried, strict=True)]
    best = ranks.index(max(ranks))
    return _Explanation(tried[best][0], gains[best], tried[best][1])


def _may_be_in_the_mirror(faults: Sequence[Fault], result: CalibrationResult) -> bool:
    """Return whether cameras that are said to be mirrored may as well not be.

    A world in the mirror fits as well, so what most cameras show is the right way round; and of
    cameras far away one that looks from the opposite side sees what a mirrored one does.
    """
    mirrored = {fault.camera for fault in faults if fault.word == "mirrored"}
    cameras = sum(len(group.rig) for group in result.groups) + len(result.left_out)
    from_afar = result.groups[0].uncertainty.weak_perspective.all()
    return bool(mirrored) and bool(2 * len(mirrored) >= cameras or from_afar)


def _has_moved(faults: Sequence[Fault]) -> bool:
    """Return whether a camera was moved, says one of the faults."""
    return any(fault.word == "moved" for fault in faults)


def _calibrate_mended(
    recording: Recording,
    calibrated: Calibrated,
    known: tuple[Fault, ...],
    new: tuple[Fault, ...],
    calibrate: Calibrate,
) -> tuple[tuple[Fault, ...], Calibrated]:
    """Return new faults, and what is found with them and the known ones mended.

    Where nothing can be calibrated with the mends they are only named, and nothing has changed.
    """
    if not mends_of(new):
        return new, calibrated
    try:
        mended = calibrate(apply_mends(recording, mends_of((*known, *new))))
        others = exchanged_instead(new, calibrated[0], mended[0], calibrated[1].config)
        if not others:
            return new, mended
        return others, calibrate(apply_mends(recording, mends_of((*known, *others))))
    except DegenerateError:
        return _only_named(new), calibrated


def exchanged_instead(
    found: Sequence[Fault], observed: Observed, mended: Observed, config: Config
) -> tuple[Fault, ...]:
    """Return the faults of the two others where a camera had its sides right; else nothing.

    Geometry shows only that one of three differs from two. But no body bends its knees backwards:
    the lifting network is less certain of detections whose sides are exchanged.

    observed, mended: what was known with the sides of the camera as they are, and exchanged.
    """
    names = observed.recording.names
    if len(names) != 3 or len(found) != 1 or not isinstance(found[0].mend, Sides):
        return ()
    fault = found[0]
    rise = log_spread(mended, fault.camera) - log_spread(observed, fault.camera)
    if not rise > config.diagnosis.unnatural_sides:
        return ()
    mends = [Sides(name) for name in names if name != fault.camera]
    evidence = {**fault.evidence, "spread": rise}
    return tuple(
        replace(fault, camera=mend.camera, says=describe(mend), evidence=evidence, mend=mend)
        for mend in mends
    )


def log_spread(observed: Observed, camera: str) -> float:
    """Return the logarithm of how unsure the network is of a camera's bodies, typically."""
    spread = observed.lifted.spread[observed.recording.names.index(camera)]
    lifted = np.isfinite(spread).any(-1)
    if not lifted.any():
        return float("nan")
    return float(np.median(np.log(np.nanmean(spread[lifted] ** 2, axis=-1))) / 2)


def _new_faults(found: Sequence[Fault], known: Sequence[Fault]) -> tuple[Fault, ...]:
    """Return the faults that are not known yet."""
    names = {(fault.camera, fault.word, fault.mend) for fault in known}
    return tuple(fault for fault in found if (fault.camera, fault.word, fault.mend) not in names)


def _only_named(faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """Return the faults as they are where nothing is mended."""
    return tuple(replace(fault, mend=None) for fault in faults)


def _explained_shares(recording: Recording, rivals: Sequence[Calibrated]) -> list[float]:
    """Return the share (0..1) of what was seen that each of some results explains.

    By the yardstick of the one with the smallest errors: a loose one makes all look alike.

    recording: as it was handed in, with what lenses cannot undo before they are mended.
    """
    yardsticks = [usual_distance(result, observed.recording) for observed, result in rivals]
    smallest = min(yardstick.angle for yardstick in yardsticks)
    strict = replace(yardsticks[0], angle=smallest)
    return [explained_share(result, recording, strict) for _, result in rivals]
