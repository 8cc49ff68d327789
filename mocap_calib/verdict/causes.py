"""What a camera may be off by, and why: the causes of a verdict that no residual shows."""

from collections.abc import Iterator, Sequence

import numpy as np

from mocap_calib.config import (
    EPOCH_MARK,
    PLAIN_FACTORS,
    VERDICT_LIMITS_DEG,
    Config,
    UncertaintyConfig,
)
from mocap_calib.errors import argument, count
from mocap_calib.geometry.lens import centre_sigma
from mocap_calib.geometry.rotation import angle_between, quarter_turn
from mocap_calib.recording.corrections import Cropped
from mocap_calib.recording.epochs import own_name
from mocap_calib.results import Cause, Clocks, Fault, GroupResult
from mocap_calib.rig import labelled_frames, matched_share
from mocap_calib.types import Camera, EstimatedCamera, Floats
from mocap_calib.verdict.checks import OPEN_DEG, report_frames

_SAME_POINT = 1.0  # pixels: readers differ by half of one in where the middle of an image is
_SPREAD_OF_MIDDLE = 0.15  # of where keypoints lie in the images of one camera, in sizes of these
_TURN_BY_SCALE = 0.3  # radians, of two cameras by the logarithm of a scale; measured 0.2 to 0.3
_ANY_DEG = 90.0  # where nothing is known
_OTHER_DEG = 10.0  # from which turn on an alternative is another answer
_AS_GOOD = 0.9  # score of an alternative, as a share of the answer's, from which on it may be right
_HARMFUL = (
    "mirrored",
    "flipped",
    "rotated",
    "resized",
    "cropped",
    "exchanged",
)  # where not corrected


def uncertain_cameras(group: GroupResult, config: Config) -> Iterator[Cause]:
    """Yield the standard deviation of each camera, with what would lower it."""
    sigma = np.rad2deg(group.uncertainty.covariance.rotation_sigma)
    turn = np.rad2deg(group.uncertainty.intrinsics_turn)
    estimated = any(isinstance(camera, EstimatedCamera) for camera in group.rig.cameras)
    for view, name in enumerate(group.rig.names):
        meaning = f"{name}: rotation +-{sigma[view]:.1f} deg"
        if 2 * turn[view] ** 2 <= sigma[view] ** 2:
            remedy = _remedy(group, view, config) if view == sigma.argmax() else "record longer"
        elif estimated:
            meaning += ", mostly because its intrinsics were estimated"
            remedy = f"give intrinsics with {argument('cameras')}"
        else:
            meaning += ", mostly because of its focal length"
            remedy = "calibrate the intrinsics again, or run again with " + argument(
                "refine", "focal"
            )
        yield Cause("covariance", name, float(sigma[view]), meaning, remedy)


def uncertain_principal_points(
    group: GroupResult, faults: Sequence[Fault], config: UncertaintyConfig
) -> Iterator[Cause]:
    """Yield what is not known of each principal point, about both axes: no residual shows it.

    What is wrong with joints moves the corner of a cropped image: it is known no better than where
    an image is taken to have its middle.
    """
    crops = {fault.camera: fault.says for fault in faults if isinstance(fault.mend, Cropped)}
    for camera in group.rig.cameras:
        if own_name(camera.name, group.rig.names) != camera.name:  # the same as before it moved
            continue
        beside = np.abs(camera.matrix[:2, 2] - (np.array(camera.size) - 1) / 2).max()
        sigma = config.principal_point * max(camera.size)
        meaning = "its principal point is assumed in the middle of the image"
        remedy = f"give intrinsics with {argument('cameras')}"
        if camera.name in crops:
            says, sigma = crops[camera.name], float(np.hypot(sigma, centre_sigma(camera, config)))
            meaning = f"its crop was estimated ({says})"
            remedy = f"undo it, or state it with {argument('crop_offset')}"
        elif not isinstance(camera, EstimatedCamera) or beside > _SAME_POINT:
            sigma = centre_sigma(camera, config)
            share = sigma / max(camera.size, default=1)
            meaning = f"its principal point is known to {share:.1%} of the image"
            remedy = "calibrate its intrinsics with a board, of images of the same size, or state "
            remedy += f"how well it is known with {argument('centre_uncertainty')}"
        turn = float(np.rad2deg(np.sqrt(2) * sigma / camera.focal))
        meaning = f"{camera.name}: rotation +-{turn:.1f} deg, because {meaning}"
        yield Cause("principal point", camera.name, turn, meaning, remedy)


def left_open(
    group: GroupResult, checks: Sequence[Cause], faults: Sequence[Fault], clocks: Clocks | None
) -> Iterator[Cause]:
    """Yield what may be wrong by any angle: what nothing determines, and what was not corrected."""
    names = group.rig.names
    if group.adjusted.depth_reversed_rig is not None:
        remedy = "move the cameras closer, or use shorter lenses"
        yield Cause("depth", "", OPEN_DEG, "a rig reversed in depth fits as well", remedy)
    own = {name.partition(EPOCH_MARK)[0] for name in names}
    for fault in faults:
        if fault.camera in own and fault.mend is None and fault.word in _HARMFUL:
            meaning = f"{fault.camera}: {fault.says}, which was not corrected"
            yield Cause(fault.word, fault.camera, OPEN_DEG, meaning, "correct its files")
    for name in np.array(names)[group.uncertainty.outlier_cameras].tolist():
        meaning = f"{name}: it contradicts the other cameras, and no correction was found"
        remedy = "check its keypoints, its clock and its intrinsics"
        shown = [each.error_deg for each in checks if each.camera == name and each.error_deg > 0]
        # the rig bends to a camera that is wrong: it is off by more than its detections show
        yield Cause("inconsistent", name, OPEN_DEG * float(np.linalg.norm(shown)), meaning, remedy)
    for clock in () if clocks is None or clocks.changed else clocks.cameras:
        if clock.differs and clock.camera in own:
            meaning = f"{clock.camera}: it is on another clock, which was not corrected"
            remedy = f"use {argument('sync', 'auto')}"
            yield Cause("clock", clock.camera, OPEN_DEG, meaning, remedy)


def mirrored_world(group: GroupResult) -> Iterator[Cause]:
    """Yield that all images may be mirrored, or the names of left and right exchanged in all."""
    nats = group.uncertainty.mirrored
    if not nats > 0 or group.uncertainty.weak_perspective.all():
        return
    meaning = "left and right are exchanged in all cameras, or all images are mirrored"
    remedy = f"use {argument('sides')} or {argument('mirrored')} of each camera"
    yield Cause("mirrored", "", _ANY_DEG * float(-np.expm1(-nats)), meaning, remedy)


def other_answers(group: GroupResult) -> Iterator[Cause]:
    """Yield another answer that fits every pair of the rig as well.

    From afar a pair reversed in depth always does; of these the whole rig decides.
    """
    if group.uncertainty.weak_perspective.all():
        return
    closest, turned = 1.0, 0.0
    for pair in group.pairs:
        others = [
            (other.score / max(pair.score, 1e-9), float(np.rad2deg(turn)))
            for other in pair.alternatives
            if (turn := angle_between(other.rotation, pair.rotation)) > np.deg2rad(_OTHER_DEG)
        ]
        share, turn_deg = max(others, default=(0.0, 0.0))
        closest, turned = min(closest, share), max(turned, turn_deg)
    # from the margin within which the scores of two answers say nothing
    doubt = float(np.clip((closest - _AS_GOOD) / (1 - _AS_GOOD), 0.0, 1.0))
    if group.pairs and doubt:
        meaning = f"two answers fit: another, turned by {turned:.0f} deg, fits each pair as well"
        remedy = "record a subject that moves otherwise, or add a camera"
        yield Cause("alternatives", "", turned * doubt, meaning, remedy)


def unchecked_by_a_third_camera(group: GroupResult, config: Config) -> Iterator[Cause]:
    """Yield what no third camera checks of a rig of two."""
    cameras = group.rig.cameras
    if len(cameras) != 2:
        return
    if all(isinstance(each, EstimatedCamera) for each in cameras):
        meaning = "the intrinsics of both cameras were estimated, and no third camera checks them"
        remedy = f"give intrinsics with {argument('cameras')}, or add a camera"
        yield Cause("intrinsics", "", OPEN_DEG, meaning, remedy)
    else:
        meaning = "no third camera checks the intrinsics of the two"
        yield Cause("intrinsics", "", VERDICT_LIMITS_DEG[0], meaning, "add a camera")
    alone = 1 - float(np.min(matched_share(group.recording, group.matches)))
    for pair in group.pairs:
        low = max(0.0, 1 - pair.score / config.averaging.weak_score)
        lack = low + alone + 1 - pair.in_front
        meaning = f"the two views agree badly: a score of {pair.score:.2f}, {alone:.0%} of the "
        meaning += f"detections unassigned, {1 - pair.in_front:.0%} of joints behind a camera"
        yield Cause("pair", "", _ANY_DEG * lack**2, meaning, "add a camera, and record longer")
    first, second = group.rig.rotation
    quarter = quarter_turn(second, first[None], config.diagnosis.upright_deg)
    if quarter and group.pairs:  # found from pairs; in a rig that was given, cameras may lie so
        meaning = f"the images of one camera may be turned by {quarter} deg"
        yield Cause("rotated", "", float(quarter), meaning, "look at the videos")


def resized_images(group: GroupResult, config: Config) -> Iterator[Cause]:
    """Yield images that may be larger than intrinsics say: of all cameras, or of one of two.

    Of three cameras the others tell of one. From afar a focal length turns nothing.
    """
    if group.uncertainty.weak_perspective.all():
        return
    cameras, recording = group.rig.cameras, group.recording
    pixels = recording.select(frames=report_frames(recording)).positions
    views = np.arange(len(cameras))
    for some in (views, *(views[[view]] for view in views if len(views) == 2)):
        seen = [pixels[view] for view in some]
        factor, share = likely_scale([cameras[view] for view in some], seen, config.uncertainty)
        turn = float(np.rad2deg(_TURN_BY_SCALE * abs(np.log(factor)) * np.sqrt(share)))
        name = cameras[some[0]].name if len(some) == 1 else ""
        meaning = f"{name or 'all cameras'}: images may be resized by {factor:.3g} against the "
        meaning += "intrinsics, by where keypoints lie in them"
        yield Cause("resized", name, turn, meaning, "state the size of the images")


def squeezed_images(group: GroupResult) -> Iterator[Cause]:
    """Yield that the images of all cameras may be squeezed against their intrinsics."""
    turn, aspect = np.rad2deg(group.uncertainty.aspect_turn.max()), group.uncertainty.aspect
    if turn:
        meaning = f"the images of all cameras may be squeezed by {aspect:.2f} in height against "
        meaning += "their intrinsics"
        remedy = f"check the ratio of width and height, or use {argument('resized')}"
        yield Cause("aspect", "", float(turn), meaning, remedy)


def likely_scale(
    cameras: Sequence[Camera], pixels: Sequence[Floats], config: UncertaintyConfig
) -> tuple[float, float]:
    """Return the likeliest scale (below 1) of images against intrinsics, and its probability.

    The scale is one of all cameras. By where the keypoints lie: about the middle of the images,
    which hold them all. pixels: `[..., 2]` of each camera, NaN = missing.
    """
    factors = np.array((1.0, *(factor for factor in PLAIN_FACTORS if factor < 1)))
    density = np.where(factors < 1, config.mistaken_share / len(factors), 1.0)
    for camera, found in zip(cameras, pixels, strict=True):
        seen, size = found[np.isfinite(found).all(-1)], np.array(camera.size, dtype=np.float64)
        if len(seen) and size.all():
            middle, most = np.percentile(seen, (50, 99.5), axis=0) / size
            beside = (middle / factors[:, None] - 0.5) / _SPREAD_OF_MIDDLE
            holds = (most <= factors[:, None]).all(1) | (factors == 1)
            density *= holds * np.exp(-(beside**2).sum(1) / 2) / factors**2
    likeliest = 1 + int(density[1:].argmax())
    return float(factors[likeliest]), float(density[likeliest] / max(density.sum(), 1e-300))


def _remedy(group: GroupResult, worst: int, config: Config) -> str:
    """Return what would determine a camera (index) better."""
    frames = len(labelled_frames(group.matches))
    name = group.rig.names[worst]
    if frames < config.uncertainty.time_blocks:
        return f"record longer: bodies are matched in {count(frames, 'frame')} only"
    if group.uncertainty.weak_perspective[worst]:
        return f"let the subject come closer to {name}, which is far away for the size of a body"
    return f"let the subject walk about for longer, near {name} and in view of other cameras"
