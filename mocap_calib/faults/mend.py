"""Find what is wrong with the input of single cameras, and correct it.

Faults of several kinds may fit the same errors. Each alternative is tried on the whole recording;
the share of the detections that is explained then adds to its evidence, and the likeliest for which
that suffices is taken, unless a change of another camera explains the same as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mocap_calib.config import (
    DECISIVE_NATS,
    EPOCH_MARK,
    VERDICT_LIMITS_DEG,
    Config,
    UncertaintyConfig,
)
from mocap_calib.errors import DegenerateError
from mocap_calib.faults.all_cameras import find_upward_axes
from mocap_calib.faults.compare import Alternative, find_faulty_cameras
from mocap_calib.faults.hypotheses import clock_faults, describe
from mocap_calib.faults.image_sizes import alternative_images, combine_corrections
from mocap_calib.faults.leave_one_out import hold_each, worst_camera
from mocap_calib.faults.moved import find_moved_cameras
from mocap_calib.recording.corrections import Exchanged, Sides, apply_mends
from mocap_calib.recording.epochs import own_name
from mocap_calib.results import VERDICTS, CalibrationResult, Clocks, Fault, GroupResult, Mend
from mocap_calib.rig import Observed
from mocap_calib.types import CameraClock, Floats, Recording
from mocap_calib.verdict.checks import report_frames, residuals_of
from mocap_calib.verdict.verdict import judge

# what was known before the rigs of a recording were built, and all that was found
Calibrated = tuple[Observed, CalibrationResult]
Calibrate = Callable[[Recording], Calibrated]

_ROUNDS = 3  # of finding and correcting faults: one may hide another
# evidence of all detections that a correction explains, or no longer explains: as many have errors
# of their own, about
_NATS_OF_ALL = 2000.0
# of the logarithms of focal lengths: errors that calibrated ones share, and what differs by less is
# equal
_SYSTEMATIC = UncertaintyConfig.focal_systematic / 2


def mend_faults(
    recording: Recording, calibrated: Calibrated, calibrate: Calibrate
) -> CalibrationResult:
    """Return what is found of a recording with the faults of its cameras named, and corrected.

    Where correcting is forbidden the corrections are tried all the same, as they show which of
    several alternatives is right; the result stays that of the input as it is. It does as well, and
    nothing is named, where the corrected rig is not determined: faults rest on the others. One
    camera that spoils such a rig is left out.

    recording: as it was handed in. calibrated: what was found of it. calibrate: finds the same of
        a recording that was corrected.
    """
    recording, calibrated = _choose_images(recording, calibrated, calibrate)
    known: tuple[Fault, ...] = ()
    rivals: set[str] = set()
    given, before = calibrated[1], (known, calibrated)
    for _ in range(_ROUNDS):
        observed, result = calibrated
        names = {(fault.camera, fault.word, fault.mend) for fault in known}
        alternatives = [
            tuple(each for each in one.faults if (each.camera, each.word, each.mend) not in names)
            for one in find_alternatives(observed, result, result.config)
        ]
        if not rivals <= {fault.camera for new in alternatives for fault in new}:
            known, calibrated = before  # one correction is enough, and any of them is
            break
        tried = [
            corrected
            for new in alternatives
            if mends_of(new) and not _may_be_reflected((*known, *new), result)
            if (corrected := _try_correction(recording, calibrated, known, new, calibrate))
        ]
        if not tried:  # faults that have no correction are named
            named = {each.camera: each for new in alternatives for each in new if not each.mend}
            known += tuple(named.values())
            break
        new, recalibrated = tried[0].faults, tried[0].calibrated
        before, rivals = (known, calibrated), find_rivals(tried)
        if not result.config.mend.apply:
            known += tuple(replace(fault, mend=None) for fault in new)
            break
        known, calibrated = (*known, *new), recalibrated
    result = replace(calibrated[1], faults=combine_corrections(recording.corrected, known))
    if judge(result).groups[0].verdict == VERDICTS[-1]:
        return _without_worst(recording, replace(given, faults=recording.corrected), calibrate)
    return result


def _without_worst(
    recording: Recording, given: CalibrationResult, calibrate: Calibrate
) -> CalibrationResult:
    """Return what is found without the camera of the largest errors, where that is far surer.

    It may be of another recording, or tie groups to each other that share nothing else. The input
    stays as it is where it is not to be corrected, and where clocks are not: it may be late.
    """
    group, config = given.groups[0], given.config
    corrects = config.mend.apply and config.sync.mode == "auto"
    worst = worst_camera(group, config) if corrects and len(group.rig) > 2 else None
    if worst is None:
        return given
    name = own_name(group.rig.names[worst], recording.names)
    others = [view for view, other in enumerate(recording.names) if other != name]
    try:
        _, rest = calibrate(recording.select(views=others))
    except DegenerateError:
        return given
    before, after = (
        [group.assessment.error_deg for group in judge(result).groups] for result in (given, rest)
    )
    if max(after) > before[0] / 2:
        return given
    return replace(rest, faults=given.faults, left_out=(*rest.left_out, name))


def _choose_images(
    recording: Recording, calibrated: Calibrated, calibrate: Calibrate
) -> tuple[Recording, Calibrated]:
    """Return the recording, and what is found of it, with the images that explain most."""
    for over in alternative_images(recording, *calibrated):
        try:
            other = calibrate(over)
        except DegenerateError:
            continue
        if _gain_of_all(recording, _errors_of([calibrated, other])) > 0:
            recording, calibrated = over, other
    return recording, calibrated


def find_alternatives(
    observed: Observed, result: CalibrationResult, config: Config
) -> list[Alternative]:
    """Return faults of cameras, each of which may explain the same errors, the likeliest first.

    observed: what was known before the rigs were built. result: what was found with it.
    """
    exchanged = [each for group in result.groups for each in find_exchanged_cameras(group)]
    held = [hold_each(observed, group, config) for group in result.groups]
    faulty = find_faulty_cameras(observed, result, held[0], config)
    if exchanged:  # each of the two asks for the focal length of the other
        faulty = [each for each in faulty if each.faults[0].word != "focal"]
    moved = [
        each
        for group, views in zip(result.groups, held, strict=True)
        for each in find_moved_cameras(observed, group, views, config)
    ]
    single = sorted([*exchanged, *faulty, *moved], key=lambda each: -each.evidence)
    return [*find_upward_axes(result.groups[0]), *single]


@dataclass(frozen=True)
class Correction:
    """New faults, the calibration with them corrected, and the evidence (nats) of both."""

    faults: tuple[Fault, ...]
    calibrated: Calibrated
    evidence: float


def find_rivals(tried: Sequence[Correction]) -> set[str]:
    """Return the cameras whose corrections are as evident as the first one, which is another's.

    Of a rig of three, one wrong focal length makes each look odd: then none is to blame. Where two
    cameras are wrong, the second still looks odd beside the first one corrected.
    """
    own = {fault.camera for fault in tried[0].faults}
    evident = [
        {fault.camera for fault in each.faults}
        for each in tried
        if each.evidence > tried[0].evidence - DECISIVE_NATS
    ]
    return set().union(*(cameras for cameras in evident if own.isdisjoint(cameras)))


def _try_correction(
    recording: Recording,
    calibrated: Calibrated,
    known: tuple[Fault, ...],
    new: tuple[Fault, ...],
    calibrate: Calibrate,
) -> Correction | None:
    """Return new faults and the calibration with them corrected, None where it explains no more.

    Nor where the detections do not determine the corrected rig: what is said of a camera rests on
    the others.
    """
    try:
        corrected = calibrate(apply_mends(recording, mends_of((*known, *new))))
        others = _sides_of_others(new, recording.names, corrected[1])
        if others:
            new = others
            corrected = calibrate(apply_mends(recording, mends_of((*known, *new))))
    except DegenerateError:
        return None
    known_of = corrected[1].groups[0].uncertainty
    sigma = known_of.covariance.rotation_sigma.max()
    if not np.rad2deg(sigma) < VERDICT_LIMITS_DEG[-1] or known_of.mirrored > DECISIVE_NATS:
        return None
    errors = _errors_of([calibrated, corrected])
    if not _fits(new, errors[1], corrected[1]):
        return None
    nats = min(float(fault.evidence["nats"]) for fault in new)
    nats += _gain_of_all(recording, errors)
    return Correction(new, corrected, nats) if nats > DECISIVE_NATS else None


def confirm_clocks(
    recording: Recording, retimed: Calibrated, clocks: Clocks, calibrate: Calibrate
) -> tuple[Calibrated, Clocks]:
    """Return what is found of a recording on the clocks of its cameras, and these clocks.

    On the frame numbers as they are where these explain as many detections: bodies that are lifted
    badly agree at any time.

    recording: as it is. retimed: what was found of it on these clocks.
    """
    if not clocks.changed:
        return retimed, clocks
    try:
        numbered = calibrate(recording)
    except DegenerateError:
        return retimed, clocks
    nats = min(camera.evidence["gain"] for camera in clocks.cameras if camera.differs)
    nats += _gain_of_all(recording, _errors_of([numbered, retimed]))
    if nats > DECISIVE_NATS:
        return retimed, clocks
    cameras = (
        CameraClock(camera.camera, evidence=camera.evidence) if camera.differs else camera
        for camera in clocks.cameras
    )
    return numbered, Clocks.of_one(recording, cameras)


def mends_of(faults: Sequence[Fault]) -> tuple[Mend, ...]:
    """Return the corrections of faults; one of two cameras counts once."""
    mends = (fault.mend for fault in faults if not isinstance(fault.mend, CameraClock))
    return tuple(dict.fromkeys(mend for mend in mends if mend is not None))


def _may_be_reflected(faults: Sequence[Fault], result: CalibrationResult) -> bool:
    """Return whether cameras that are said to be mirrored may as well not be.

    A world in the mirror fits as well, so what most cameras show is the right way round; and of
    cameras far away one that looks from the opposite side sees what a mirrored one does.
    """
    mirrored = {fault.camera for fault in faults if fault.word == "mirrored"}
    cameras = sum(len(group.rig) for group in result.groups) + len(result.left_out)
    from_afar = result.groups[0].uncertainty.weak_perspective.all()
    return bool(mirrored) and bool(2 * len(mirrored) >= cameras or from_afar)


def _sides_of_others(
    found: Sequence[Fault], names: Sequence[str], corrected: CalibrationResult
) -> tuple[Fault, ...]:
    """Return the faults of the others where cameras that differ from them had their sides right.

    Geometry shows only that these differ from those. But with all sides exchanged bodies are seen
    in the mirror. Where the others are more than twice as many, they are taken to be right.

    names: of all cameras. corrected: what was found with the sides of the cameras exchanged.
    """
    own = [fault.camera for fault in found if isinstance(fault.mend, Sides)]
    others = [name for name in names if name not in own]
    mirrored = corrected.groups[0].uncertainty.mirrored > DECISIVE_NATS
    if not mirrored or len(own) < len(found) or len(others) > 2 * len(own):
        return ()
    mends = [Sides(name) for name in others]
    return tuple(
        Fault(mend.camera, mend.word, describe(mend), found[0].evidence, mend) for mend in mends
    )


def _errors_of(results: Sequence[Calibrated]) -> list[Floats]:
    """Return the distances of keypoints from their triangulated points, of each of some results.

    `[keypoint, individual, frame, view]`, NaN = missing; in the focal lengths of the first result,
    whatever is corrected of them.
    """
    focal = {camera.name: camera.focal for camera in results[0][0].recording.cameras}
    errors = []
    for _, result in results:
        own = [focal.get(each.name, each.focal) for each in result.groups[0].rig.cameras]
        errors.append(residuals_of(result.groups[0]).distance.T / own)
    return errors


def _fits(faults: Sequence[Fault], errors: Floats, result: CalibrationResult) -> bool:
    """Return whether cameras that were corrected are in the rig, and no outliers there."""
    names = [name.partition(EPOCH_MARK)[0] for name in result.groups[0].rig.names]
    own, factor = {fault.camera for fault in faults}, result.config.uncertainty.outlier_factor
    corrected = np.array([name in own for name in names])
    if not own <= set(names):
        return False
    if corrected.all():  # no other camera is left to compare with
        return True
    of_others = factor * np.nanmedian(errors[..., ~corrected])
    return all(np.nanmedian(errors[..., view]) < of_others for view in np.flatnonzero(corrected))


def _gain_of_all(recording: Recording, errors: Sequence[Floats]) -> float:
    """Return the evidence (nats) by which the second of two results explains more detections.

    By the share (0..1) of all detected keypoints that each explains. A keypoint counts
    1 / (1 + (e / width)^2), e being its error, and nothing where it is unmatched or its camera is
    left out. The width is the median error of the result with the smaller: a loose one makes both
    look alike.

    recording: as it was handed in, with what lenses cannot undo before they are corrected. errors:
        as of `_errors_of`.
    """
    width = min(float(np.nanmedian(error)) for error in errors)
    detected = max(int(recording.select(frames=report_frames(recording)).seen.sum()), 1)
    before, after = (float(np.nansum(1 / (1 + (error / width) ** 2))) for error in errors)
    return _NATS_OF_ALL * (after - before) / detected


def find_exchanged_cameras(group: GroupResult) -> list[Alternative]:
    """Return the two cameras whose intrinsics are exchanged; nothing where none are.

    Each looks wrong by itself, and spoils the rig that it would be held against. The evidence is
    how much likelier the changes are that the adjustment asks of their focal lengths, where each
    has that of the other; nothing else gives them away.
    """
    change, sigma = group.uncertainty.focal_change, group.uncertainty.focal_sigma
    focal = np.log([camera.focal for camera in group.rig.cameras])
    if len(focal) < 3 or not np.isfinite(change).all():
        return []
    variance = sigma**2 + _SYSTEMATIC**2
    likelier = []
    for a, b in combinations(range(len(focal)), 2):
        ends, other = np.array([a, b]), focal[[b, a]] - focal[[a, b]]
        nats = (change[ends] ** 2 - (change[ends] - other) ** 2) / (2 * variance[ends])
        if abs(other[0]) > _SYSTEMATIC and (nats > 0).all():
            likelier.append((float(nats.sum()), a, b))
    nats, *views = max(likelier, default=(0.0, 0, 0))
    if nats < DECISIVE_NATS:
        return []
    first, second = (group.rig.names[view] for view in views)
    mend = Exchanged(first, second)
    faults = tuple(
        Fault(one, "exchanged", f"has the intrinsics of {other}", {"nats": nats}, mend)
        for one, other in ((first, second), (second, first))
    )
    return [Alternative(faults, nats)]


# --- clocks


def add_clocks(result: CalibrationResult, clocks: Clocks) -> CalibrationResult:
    """Return the result with the clocks of its cameras, and the faults that they are.

    clocks: by which the recording was put on one clock; where they change nothing, what differs was
        found and not applied.
    """
    groups = result.groups
    if clocks.changed:
        groups = tuple(_with_clocks(group, clocks) for group in groups)
    faults = clock_faults(clocks, applied=clocks.changed)
    # what is found of a camera whose rig is not determined would rest on the others
    unknown = {
        name.partition(EPOCH_MARK)[0]
        for group in groups
        if group.verdict == VERDICTS[-1]
        for name in group.rig.names
    }
    faults = tuple(fault for fault in faults if not fault.mend or fault.camera not in unknown)
    return replace(result, groups=groups, clocks=clocks, faults=(*faults, *result.faults))


def _with_clocks(group: GroupResult, clocks: Clocks) -> GroupResult:
    """Return the group with a rig that says which of its cameras have other clocks."""
    different = [clock for clock in clocks.cameras if clock.differs]
    own = tuple(
        replace(clock, camera=name)
        for name in group.rig.names
        for clock in different
        if name.partition(EPOCH_MARK)[0] == clock.camera
    )
    rig = replace(group.rig, clocks=own)
    return replace(group, adjusted=replace(group.adjusted, rig=rig))
