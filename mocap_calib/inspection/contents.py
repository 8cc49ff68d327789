"""What keypoint files hold, as plain numbers and texts that JSON can take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.recording.far_points import without_far_points
from mocap_calib.recording.joints import normalise_name
from mocap_calib.recording.names import find_names, keypoint_meanings
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, Camera, Floats, Ints, Keypoints2D, Reals, Skeleton


@dataclass(frozen=True)
class InspectConfig:
    """What `inspect` warns of.

    cells: of the grid over the image, each way.
    outside: share of the points outside the image.
    enough_frames: that a camera sees together with another one. The worst of four simulated scenes
        (four cameras, one walker) is 3.0 deg off with 3 frames, 2.2 with 6, 2.1 with 10, and 0.5
        with 20. Fewest in a shared recording: 20.
    low_confidence: of half of the points.
    copied: detections that two files have in common; `run` refuses only what is certain.
    gaps: share of the frame numbers between the first and the last.
    motion_frames, motion_percentile: what `measure_motion` compares.
    least_motion: median over the cameras of what that returns. Measured: 0.05 of a mouse that sits
        (a rig 19 deg off), 0.21 of a tethered fly, 0.36 and more in the other recordings, 0.45 of
        three people who sit; simulated, 0.02 to 0.07 where one frame is repeated with 1 to 3 px of
        noise, 0.16 to 0.22 where somebody walks on the spot, 0.3 and more where people go about
        for 10 frames, 0.8 and more for 60.
    single_share: of the frames in which two views see somebody, that show each of them one body.
    compared_frames, most_pairs: of two views, that `inspection.view_pairs` compares, and of views.
    least_matches, most_matches: joints of these.
    most_error: of two views whose images of one subject go together. Measured: 0.04 in shared
        recordings, 0.2 and more where keypoints are noise.
    least_depth: median over pairs of views of the error of a homography over that of a fundamental
        matrix. Measured: 5.1 and more in shared recordings, 9.3 and more in simulated ones, less
        than 3 where all that is seen lies in a plane.
    """

    cells: int = 10
    outside: float = 0.01
    enough_frames: int = 20
    low_confidence: float = 0.1
    copied: int = 1
    gaps: float = 0.1
    motion_frames: int = 40
    motion_percentile: float = 90.0
    least_motion: float = 0.1
    single_share: float = 0.9
    compared_frames: int = 1000
    most_pairs: int = 30
    least_matches: int = 100
    most_matches: int = 2000
    most_error: float = 0.1
    least_depth: float = 3.0


def inspect_views(
    views: Sequence[Keypoints2D],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
    config: InspectConfig,
) -> dict[str, Any]:
    """Return what the files hold, in three sections.

    `cameras`: what each file has (frames, detections, keypoints, missing points, motion, scores,
        image).
    `pairs`: how much each two cameras see together.
    `model`: how many of the skeleton's joints are among the keypoints, and which keypoints it does
    not know, after `aliases` (own name -> joint) were applied.
    """
    meanings = keypoint_meanings(views, skeleton, aliases)
    joints = {normalise_name(joint) for joint in skeleton.keypoints}
    return {
        "cameras": [_describe_camera(view, config) for view in views],
        "pairs": [_describe_pair(a, b, meanings) for a, b in combinations(views, 2)],
        "model": {
            "name": skeleton.name,
            "knows": len(joints & set(meanings.values())),
            "unknown": [name for name, meaning in meanings.items() if meaning not in joints],
        },
    }


def fill_image_sizes(
    views: Sequence[Keypoints2D], cameras: Sequence[Camera]
) -> tuple[Keypoints2D, ...]:
    """Return the views, with the image sizes of the cameras of their names where they have none.

    Points far outside of images are missing.
    """
    sizes = {camera.name: camera.size for camera in cameras}
    found = find_names([view.camera for view in views], list(sizes))
    sized = (
        replace(view, image_size=sizes[names[0]])
        if view.image_size == (0, 0) and len(names) == 1
        else view
        for view, names in zip(views, found, strict=True)
    )
    return tuple(without_far_points(view, view.image_size) for view in sized)


def seen_points(view: Keypoints2D) -> Bools:
    """Return `[frame, instance, keypoint]` where there is a point."""
    return np.asarray(np.isfinite(view.positions[..., 0]))


# --- one camera


def _describe_camera(view: Keypoints2D, config: InspectConfig) -> dict[str, Any]:
    """Return what one file holds."""
    seen = seen_points(view)
    detected: Bools = np.asarray(seen.any(-1))  # [frame, instance]
    in_frame, points = detected.sum(axis=1), int(seen.sum())
    ever: Bools = np.asarray(seen.any((0, 1)))  # [keypoint]
    return {
        "name": view.camera,
        "source": view.source,
        "frames": _describe_frames(view.frames),
        "detections": int(detected.sum()),
        "most_at_once": int(in_frame.max(initial=0)),
        "followed": view.tracked,
        "empty_frames": int((in_frame == 0).sum()),
        "keypoints": list(view.keypoints),
        "never_seen": [name for name, found in zip(view.keypoints, ever, strict=True) if not found],
        "points": points,
        "missing": {
            name: {"points": count, "share": count / (points + sum(view.missing.values()))}
            for name, count in view.missing.items()
        },
        "motion": measure_motion(view, config),
        "confidence": {
            name: float(np.quantile(view.confidence[seen], share)) if points else None
            for name, share in {"least": 0.0, "median": 0.5, "most": 1.0}.items()
        },
        "image": _describe_image(view.positions[seen], view.image_size, config),
        "remarks": list(view.remarks),
    }


def _describe_frames(frames: Ints) -> dict[str, Any]:
    """Return the count, the ends and the gaps of frame numbers `[frame]`."""
    first, last = (int(frames[0]), int(frames[-1])) if len(frames) else (None, None)
    before = np.flatnonzero(np.diff(frames) > 1)
    gaps = [[int(frames[k]) + 1, int(frames[k + 1]) - 1] for k in before]
    return {"count": len(frames), "first": first, "last": last, "gaps": gaps}


def _describe_image(points: Reals, size: tuple[int, int], config: InspectConfig) -> dict[str, Any]:
    """Return the size of the image, the span of the points `[N, 2]`, and how they lie in it.

    `covered` is the share of the cells of a grid that have any; the grid lies over the image, or
    over the span of the points where the size is not known.
    """
    if not len(points):
        nothing = {"least": None, "most": None, "covered": 0.0, "outside": 0.0}
        return {"size": list(size), **nothing}
    low, high = least, most = points.min(axis=0), points.max(axis=0)
    if size != (0, 0):
        low, high = np.zeros(2), np.array(size, dtype=float)
    inside: Bools = ((points >= low) & (points <= high)).all(-1)
    extent = np.maximum(high - low, 1e-9)
    cell = ((points[inside] - low) / extent * config.cells).astype(np.int64)
    return {
        "size": list(size),
        "least": least.tolist(),
        "most": most.tolist(),
        "covered": len(np.unique(cell.clip(0, config.cells - 1), axis=0)) / config.cells**2,
        "outside": float((~inside).mean()),
    }


# --- two cameras


def _describe_pair(a: Keypoints2D, b: Keypoints2D, meanings: Mapping[str, str]) -> dict[str, Any]:
    """Return how much two cameras see together.

    `frames` that both have, `covisible` frames in which both see somebody, `joints` that both name.
    """
    frames, rows_a, rows_b = np.intersect1d(a.frames, b.frames, return_indices=True)
    sees_a: Bools = np.asarray(seen_points(a).any((1, 2)))[rows_a]
    sees_b: Bools = np.asarray(seen_points(b).any((1, 2)))[rows_b]
    joints_a = {meanings[name] for name in a.keypoints}
    joints_b = {meanings[name] for name in b.keypoints}
    return {
        "a": a.camera,
        "b": b.camera,
        "frames": len(frames),
        "covisible": int((sees_a & sees_b).sum()),
        "joints": len(joints_a & joints_b),
    }


# --- how far subjects move. What stands still shows all frames alike and does not determine a rig:
# the errors of a detector on a still subject do not average out, and the rig bends to fit them.


def measure_motion(view: Keypoints2D, config: InspectConfig) -> float | None:
    """Return how far from each other the detections of two frames are, in sizes of their bodies.

    From a detection to the nearest one of another frame, whoever that is: the median distance of
    their keypoints over the RMS distance of its keypoints from their middle. The 90th percentile
    of that over pairs of frames, which are evenly spread. None where no two frames can be compared.
    """
    seen = np.isfinite(view.positions[..., 0]).sum(-1) >= LEAST_JOINTS  # [frame, instance]
    frames = evenly_spaced(np.flatnonzero(seen.any(1)), config.motion_frames)
    shown = seen[frames]
    positions = np.asarray(view.positions[frames], dtype=float)
    positions = np.where(shown[..., None, None], positions, np.nan)
    distances = [
        _nearest(positions[k], np.delete(positions, k, axis=0))[:, shown[k]].ravel()
        for k in range(len(frames))  # all pairs at once may be gigabytes
    ]
    found = np.concatenate(distances) if distances else np.empty(0)
    found = found[np.isfinite(found)]
    return float(np.percentile(found, config.motion_percentile)) if len(found) else None


def _nearest(detections: Floats, others: Floats) -> Floats:
    """Return how far the nearest detection of other frames is, `[frame, instance]`, in body sizes.

    detections: `[instance, keypoint, 2]` of one frame. others: `[frame, instance, keypoint, 2]`.
    It is NaN where nothing can be compared.
    """
    spread = detections - mean_of_known(detections, 1)[:, None]
    size = np.sqrt(mean_of_known((spread**2).sum(-1), 1))  # [instance]
    gap = np.linalg.norm(detections[None, :, None] - others[:, None], axis=-1)
    comparable = np.isfinite(gap).sum(-1) >= LEAST_JOINTS  # [frame, instance, other instance]
    gap = np.where(comparable[..., None], gap, np.inf)
    # of those that are missing none is the nearest; NaN goes last in the order
    order = np.sort(gap, axis=-1)
    middle = (np.isfinite(gap).sum(-1, keepdims=True) - 1).clip(0) // 2
    median = np.take_along_axis(order, middle, axis=-1)[..., 0]
    nearest = median.min(-1, initial=np.inf) / np.maximum(size, 1e-9)
    return np.where(np.isfinite(nearest), nearest, np.nan)
