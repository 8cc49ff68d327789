"""What is wrong with the files of single cameras, as a calibration shows it, and mending it.

A mend counts only where the calibration of the mended recording explains more of what was seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.multi_view.exchanged import find_exchanged_cameras
from mocap_calib.multi_view.explained import explained_share, usual_distance
from mocap_calib.multi_view.moved import find_moved_cameras
from mocap_calib.multi_view.observed import Observed
from mocap_calib.multi_view.odd_cameras import find_odd_cameras
from mocap_calib.multi_view.sides import exchanged_instead
from mocap_calib.multi_view.unrelated import find_unrelated_cameras
from mocap_calib.recording.mending import apply_mends
from mocap_calib.types import CalibrationResult, Fault, Mend, Recording

# what was known before the rigs of a recording were built, and all that was found
Calibrated = tuple[Observed, CalibrationResult]


def mend_faults(
    recording: Recording, calibrated: Calibrated, calibrate: Callable[[Recording], Calibrated]
) -> CalibrationResult:
    """Return what is found of a recording with the faults of its cameras named, and mended.

    recording: as it was handed in. calibrated: what was found of it. calibrate: finds the same of
        a recording that was mended.
    """
    observed, result = calibrated
    config = result.config.mend
    faults: tuple[Fault, ...] = ()
    for _ in range(config.rounds):
        found = _new_faults(find_faults(observed, result, result.config), faults)
        if not mends_of(found):
            faults += found
            break
        mended = None
        if config.apply:
            mended = _calibrate_mended(recording, (*faults, *found), calibrate)
            others = exchanged_instead(found, observed, mended[0], result.config) if mended else ()
            if others:
                found = others
                mended = _calibrate_mended(recording, (*faults, *found), calibrate)
        if mended is None:
            faults += _only_named(found)
            break
        gain = _gain(mended, (observed, result))
        if gain <= 0:
            faults += _only_named(found) if gain > -config.refuting_loss else ()
            break
        observed, result = mended
        faults += found
    return replace(result, faults=faults)


def find_faults(observed: Observed, result: CalibrationResult, config: Config) -> tuple[Fault, ...]:
    """Return what is wrong with the files of cameras that stand out.

    observed: what was known before the rigs were built. result: what was found with the files as
        they are.
    """
    groups = result.groups
    moved = [fault for group in groups for fault in find_moved_cameras(observed, group, config)]
    if moved:
        return tuple(moved)
    exchanged = [
        fault for group in groups for fault in find_exchanged_cameras(observed, group, config)
    ]
    odd = exchanged or find_odd_cameras(observed, result, config)
    if odd:
        return tuple(odd)
    return tuple(
        fault for group in groups for fault in find_unrelated_cameras(observed, group, config)
    )


def mends_of(faults: Sequence[Fault]) -> tuple[Mend, ...]:
    """Return the mends of faults; one of two cameras counts once."""
    return tuple(dict.fromkeys(fault.mend for fault in faults if fault.mend is not None))


def _new_faults(found: Sequence[Fault], known: Sequence[Fault]) -> tuple[Fault, ...]:
    """Return the faults that are not known yet."""
    names = {(fault.camera, fault.word, fault.mend) for fault in known}
    return tuple(fault for fault in found if (fault.camera, fault.word, fault.mend) not in names)


def _calibrate_mended(
    recording: Recording,
    faults: Sequence[Fault],
    calibrate: Callable[[Recording], Calibrated],
) -> Calibrated | None:
    """Return what is found of a recording whose faults are mended, None where that fails."""
    try:
        return calibrate(apply_mends(recording, mends_of(faults)))
    except DegenerateError:
        return None


def _only_named(faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """Return the faults as they are where nothing is mended."""
    return tuple(replace(fault, mend=None) for fault in faults)


def _gain(mended: Calibrated, before: Calibrated) -> float:
    """Return by how much (-1 to 1) more of what was seen the mends explain."""
    yardstick = usual_distance(before[1], before[0].recording)
    after, given = (
        explained_share(result, observed.recording, yardstick)
        for observed, result in (mended, before)
    )
    return after - given
