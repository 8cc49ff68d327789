"""Say in words why a rig is no better than its verdict, and what to do about it."""

from collections.abc import Iterator

import numpy as np

from mocap_calib.config import Config
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.observations import labelled_frames
from mocap_calib.types import Bools, Check, EstimatedCamera, GroupResult
from mocap_calib.wording import count

_FRAMES = 300  # that tell whether a subject moves, and which cameras see it together

# by the name of a check: what it means where it fails, and the remedy
MEANING = {
    "convergence": (
        "adjusting and matching did not come to an end",
        "look for a camera with large errors, and record longer",
    ),
    "moments": (
        "bodies are matched in few frames only: what all joints of a moment share does not show",
        "record longer",
    ),
    "held-out frames": (
        "errors are {value:.2f} times as large in a fifth of the recording that the rig was made "
        "without",
        "check that the cameras stayed where they are, and record longer",
    ),
    "flat": (
        "all that was seen may as well lie in one plane: other rigs would fit, too",
        "let the subject come closer, rise, jump or tilt",
    ),
    "bones": (
        "distances on bodies vary by {value:.0%} at least",
        "check the keypoints, and who is who, in the 3D poses",
    ),
    "loops": (
        "{value:.0%} of the pairs of cameras contradict the rig",
        "check the keypoints, and that all files are of one time",
    ),
    "bridge": (
        "two parts of the rig hardly go together: their bodies look alike {value:.1f} times less "
        "than within a part",
        "check that all files are of one recording; or let the subject cross where both parts look",
    ),
    "pair score": (
        "{camera}: the bodies it sees do not look like those of any other camera",
        "check that its file belongs to this recording",
    ),
    "clock": (
        "{camera}: its clock seems to be off by {value:.2f} frames",
        "trigger the cameras together, or record at a higher rate",
    ),
    "lens": (
        "{camera}: errors grow towards the edge of the image ({value:.1f} standard deviations)",
        "its lens may be another than given: calibrate it, or run again with --refine focal+k1",
    ),
    "over time": (
        "{camera}: errors are {value:.1f} times as large for a while",
        "check whether it was moved, or out of step, for a part of the recording",
    ),
    "unmatched": (
        "{camera}: {value:.0%} of its detections match nobody",
        "check its keypoints: detections of nobody, or people whom no other camera sees",
    ),
    "errors": (
        "{camera}: errors are {value:.0%} of the size of a body",
        "check its keypoints, its clock and its intrinsics",
    ),
}


def explain(group: GroupResult, config: Config) -> Iterator[str]:
    """Yield why the rig of a group is no better than its verdict, a line with a remedy each."""
    if np.rad2deg(group.uncertainty.covariance.rotation_sigma.max()) >= (
        config.verdict.well_determined_deg
    ):
        yield from _explain_error(group, config)
    if group.uncertainty.outlier_cameras.any():
        names = _names(group, group.uncertainty.outlier_cameras)
        yield (
            f"{names}: errors several times those of the others; look whether one is out of step "
            "(--frame-offset), was moved, or has other intrinsics"
        )
    if group.uncertainty.wrong_focal.any():
        yield _explain_focal(group)
    if group.adjusted.depth_reversed_rig is not None:
        yield (
            "a rig reversed in depth fits as well and nothing tells which is right; move the "
            "cameras closer, or use shorter lenses"
        )
    yield from (_describe(check) for check in group.checks if not check.passed)


def _explain_focal(group: GroupResult) -> str:
    """Return by how much focal lengths would change, and how sure that is."""
    change, sigma = group.uncertainty.focal_change, group.uncertainty.focal_sigma
    changes = [
        f"{group.rig.names[view]} {change[view]:+.1%} (+- {sigma[view]:.1%})"
        for view in np.flatnonzero(group.uncertainty.wrong_focal)
    ]
    remedy = "check intrinsics and the size of images, or run again with --refine focal"
    return f"{', '.join(changes)}: fits better with the focal length changed by that; {remedy}"


def _describe(check: Check) -> str:
    """Return what a check that failed means, and the remedy."""
    meaning, remedy = MEANING[check.name]
    return f"{meaning.format(value=check.value, camera=check.camera)}; {remedy}"


def _names(group: GroupResult, which: Bools) -> str:
    """Return the names of some cameras (`[view]` bools)."""
    return ", ".join(group.rig.names[view] for view in np.flatnonzero(which))


def _explain_error(group: GroupResult, config: Config) -> Iterator[str]:
    """Yield how far the worst camera may be off, and what most likely stands behind it."""
    sigma = group.uncertainty.covariance.rotation_sigma
    worst = int(sigma.argmax())
    said = f"camera {group.rig.names[worst]} may be turned by {np.rad2deg(sigma[worst]):.1f} deg"
    if 2 * group.uncertainty.intrinsics_turn[worst] ** 2 > sigma[worst] ** 2:
        if any(isinstance(camera, EstimatedCamera) for camera in group.rig.cameras):
            yield f"{said}, most of it as intrinsics are estimated; give them (--cameras)"
            return
        remedy = "calibrate the intrinsics anew, or run again with --refine focal"
        yield f"{said}, most of it by focal lengths; {remedy}"
        return
    yield f"{said}; {_remedy(group, config, worst)}"


def _remedy(group: GroupResult, config: Config, worst: int) -> str:
    """Return what would determine a camera (index) better."""
    frames = len(labelled_frames(group.matches))
    if frames < config.verdict.few_frames:
        return f"record longer: bodies are matched in {count(frames, 'frame')} only"
    if group.uncertainty.weak_perspective[worst]:
        return "let the subject come closer: the camera is far away for the size of what it sees"
    partners = _partners(group, worst)
    if partners.sum() == 1 and _faces(group, worst, config.verdict.facing_deg)[partners].all():
        return (
            f"{group.rig.names[worst]} and {_names(group, partners)} face each other, and no third "
            "camera sees what both do: add one between"
        )
    if _stands_still(group):
        return "let the subject walk about and turn: it hardly moves"
    return "let the subject walk about, nearer to it and in view of other cameras, for longer"


def _partners(group: GroupResult, view: int) -> Bools:
    """Return `[view]` which others see an individual in the same frame as a view does."""
    labels = group.matches.labels
    labels = labels[:, evenly_spaced(np.arange(labels.shape[1]), _FRAMES)]
    individuals = range(group.matches.individuals)
    sees = np.stack([(labels == each).any(-1) for each in individuals])  # [individual, view, frame]
    together = np.asarray((sees & sees[:, view : view + 1]).any((0, 2)))
    together[view] = False
    return together


def _faces(group: GroupResult, view: int, least_deg: float) -> Bools:
    """Return `[view]` which cameras look the other way."""
    axes = group.rig.rotation[:, 2]
    return np.asarray(axes @ axes[view] < np.cos(np.deg2rad(least_deg)))


def _stands_still(group: GroupResult) -> bool:
    """Return whether bodies move by less than their own size in all images.

    A rig that is wrong places bodies anywhere; the images do not depend on it.
    """
    positions, labels = group.recording.positions, group.matches.labels
    frames = evenly_spaced(np.arange(labels.shape[1]), _FRAMES)
    ways: list[float] = []
    for seen, label in zip(positions, labels, strict=True):
        for individual in range(group.matches.individuals):
            frame, instance = np.nonzero(label[frames] == individual)
            bodies = np.asarray(seen[frames[frame], instance], dtype=np.float64)
            if len(bodies) < 2:
                continue
            middle = np.nanmedian(bodies, axis=1)
            size = np.nanmedian(np.linalg.norm(bodies - middle[:, None], axis=-1))
            way = np.median(np.linalg.norm(middle - np.median(middle, axis=0), axis=-1))
            ways.append(float(way / size))
    return bool(ways) and max(ways) < 1
