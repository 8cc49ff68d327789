"""What is in keypoint files, before any calibration: numbers per camera and per pair, and what stands in the way of a run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from mocap_calib.config import InspectConfig, SampleConfig
from mocap_calib.errors import MismatchError
from mocap_calib.recording.joints import SHIPPED, normalise_name
from mocap_calib.recording.sampling import choose_sample_frames
from mocap_calib.recording.synchronise import (
    LEAST_JOINTS,
    check_joints,
    check_pixels,
    check_shared,
    make_recording,
    meanings,
    name_mapping,
    views_named,
)
from mocap_calib.types import Bools, Camera, Ints, Keypoints2D, Skeleton

_LISTED = 6  # names in one message


@dataclass(frozen=True)
class Finding:
    """Something that stands in the way. critical: a run could not work; else it may be worse than it could be. message: one line with the remedy."""

    critical: bool
    message: str


def inspect_views(
    views: Sequence[Keypoints2D],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
    config: InspectConfig,
) -> dict[str, Any]:
    """What the files hold, as plain numbers: `cameras`, `pairs`, and how many of the joints the `model` of the skeleton knows by these aliases."""
    meant = meanings(views, skeleton, aliases)
    joints = {normalise_name(joint) for joint in skeleton.keypoints}
    return {
        "cameras": [_camera(view, config) for view in views],
        "pairs": [_pair(a, b, meant) for a, b in combinations(views, 2)],
        "model": {
            "name": skeleton.name,
            "knows": len(joints & set(meant.values())),
            "unknown": [name for name, meaning in meant.items() if meaning not in joints],
        },
    }


def with_sizes(views: Sequence[Keypoints2D], cameras: Sequence[Camera]) -> tuple[Keypoints2D, ...]:
    """The views, with the image sizes of the cameras of their names where their files have none."""
    sizes = [
        next((camera.size for camera in cameras if views_named([view], [camera])), (0, 0))
        for view in views
    ]
    return tuple(
        replace(view, image_size=size) if view.image_size == (0, 0) else view
        for view, size in zip(views, sizes, strict=True)
    )


def _camera(view: Keypoints2D, config: InspectConfig) -> dict[str, Any]:
    seen = _seen(view)
    there: Bools = np.asarray(seen.any(-1))
    named: Bools = np.asarray(seen.any((0, 1)))
    points, missing = int(seen.sum()), sum(view.missing.values())
    scores = view.confidence[seen]
    return {
        "name": view.camera,
        "source": view.source,
        "frames": _frames(view.frames),
        "detections": int(there.sum()),
        "most_at_once": int(there.sum(axis=1).max(initial=0)),
        "followed": view.tracked,
        "empty_frames": int((~there.any(axis=1)).sum()),
        "keypoints": list(view.keypoints),
        "never_seen": [name for name, ever in zip(view.keypoints, named, strict=True) if not ever],
        "points": points,
        "missing": {
            name: {"points": count, "share": count / (points + missing)}
            for name, count in view.missing.items()
        },
        "confidence": {
            name: float(np.quantile(scores, q)) if points else None
            for name, q in (("least", 0.0), ("median", 0.5), ("most", 1.0))
        },
        "image": _image(view, seen, config),
        "remarks": list(view.remarks),
    }


def _seen(view: Keypoints2D) -> Bools:
    return np.asarray(np.isfinite(view.positions[..., 0]))


def _frames(frames: Ints) -> dict[str, Any]:
    first, last = (int(frames[0]), int(frames[-1])) if len(frames) else (None, None)
    return {"count": len(frames), "first": first, "last": last, "gaps": _gaps(frames)}


def _gaps(frames: Ints) -> list[list[int]]:
    """First and last number of each run of numbers that is not there, between the first and the last that is."""
    ends = np.flatnonzero(np.diff(frames) > 1)
    return [[int(frames[k]) + 1, int(frames[k + 1]) - 1] for k in ends]


def _image(view: Keypoints2D, seen: Bools, config: InspectConfig) -> dict[str, Any]:
    """Size, the span of the points, and the share of the cells of a grid over the image, or over the span where it has no size, that have any."""
    points = view.positions[seen]
    if not len(points):
        return {
            "size": list(view.image_size),
            "least": None,
            "most": None,
            "covered": 0.0,
            "outside": 0.0,
        }
    least, most = points.min(axis=0), points.max(axis=0)
    low, high = (
        (np.zeros(2), np.array(view.image_size, dtype=float))
        if view.image_size != (0, 0)
        else (least, most)
    )
    place = ((points - low) / np.maximum(high - low, 1e-9) * config.cells).astype(np.int64)
    inside = ((points >= low) & (points <= high)).all(-1)
    cells = np.unique(place[inside].clip(0, config.cells - 1), axis=0)
    covered = len(cells) / config.cells**2
    return {
        "size": list(view.image_size),
        "least": least.tolist(),
        "most": most.tolist(),
        "covered": covered,
        "outside": float((~inside).mean()),
    }


def _pair(a: Keypoints2D, b: Keypoints2D, meant: Mapping[str, str]) -> dict[str, Any]:
    """How much two cameras see together: frames that both have, frames in which both see somebody, joints that both name."""
    frames, in_a, in_b = np.intersect1d(a.frames, b.frames, return_indices=True)
    in_both = (np.asarray(_seen(view).any((1, 2)))[rows] for view, rows in ((a, in_a), (b, in_b)))
    both: Bools = np.logical_and(*in_both)
    joints = {meant[name] for name in a.keypoints} & {meant[name] for name in b.keypoints}
    return {
        "a": a.camera,
        "b": b.camera,
        "frames": len(frames),
        "covisible": int(both.sum()),
        "joints": len(joints),
    }


def findings(
    views: Sequence[Keypoints2D],
    report: Mapping[str, Any],
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
    config: InspectConfig,
) -> tuple[Finding, ...]:
    """What stands in the way, the critical first. Cameras may be none: then what needs them is not looked at."""
    usable = [view for view in views if _seen(view).any()]
    found = [
        *_few(views, usable),
        *_scales(usable, config),
        *_clocks(usable, report, config),
        *_joints(usable, report, meanings(usable, skeleton, aliases)),
        *_copies(usable),
    ]
    found += [Finding(False, message) for view in views for message in _worse(view, config)]
    if cameras and not any(each.critical for each in found):
        found += _with_cameras(views, cameras, skeleton, aliases)
    return tuple(sorted(found, key=lambda each: not each.critical))


def _few(views: Sequence[Keypoints2D], usable: Sequence[Keypoints2D]) -> list[Finding]:
    empty = [view for view in views if not any(view is other for other in usable)]
    found = [
        Finding(
            False,
            f"{view.camera}: no valid point in {view.source}; it will be left out: check the detector's output",
        )
        for view in empty
    ]
    if len(usable) < 2:
        names = ", ".join(view.camera for view in usable) or "none"
        found.append(
            Finding(
                True,
                f"expected detections of two cameras or more, found those of {len(usable)} ({names}); add the other keypoint files",
            )
        )
    return found


def _scales(usable: Sequence[Keypoints2D], config: InspectConfig) -> list[Finding]:
    """Positions that are no pixels, or those of another image."""
    found = []
    for view in usable:
        points = np.abs(view.positions[_seen(view)])
        outside = (
            (points > np.array(view.image_size)).any(-1).mean()
            if view.image_size != (0, 0)
            else 0.0
        )
        try:
            check_pixels(view)
        except MismatchError as error:
            found.append(Finding(True, str(error)))
            continue
        if outside > config.outside:
            size = f"{view.image_size[0]} x {view.image_size[1]}"
            found.append(
                Finding(
                    False,
                    f"{view.camera}: {outside:.0%} of the points lie outside its image of {size}; check its size, or say --crop-offset",
                )
            )
    return found


def _clocks(
    usable: Sequence[Keypoints2D], report: Mapping[str, Any], config: InspectConfig
) -> list[Finding]:
    """Frame numbers that do not go together."""
    pairs = [
        pair
        for pair in report["pairs"]
        if {pair["a"], pair["b"]} <= {view.camera for view in usable}
    ]
    if not pairs:
        return []
    ranges = ", ".join(f"{view.camera} {view.frames[0]}-{view.frames[-1]}" for view in usable)
    if not any(pair["covisible"] for pair in pairs):
        remedy = "number the frames of all cameras on one clock (--frame-offset), or check that the files are of one recording"
        return [
            Finding(True, f"no two cameras see anything in the same frame ({ranges}); {remedy}")
        ]
    found = []
    if max(pair["covisible"] for pair in pairs) < config.enough_frames:
        found.append(
            Finding(
                False,
                f"no two cameras see something together in {config.enough_frames} frames or more; record longer",
            )
        )
    together = {name for pair in pairs if pair["covisible"] for name in (pair["a"], pair["b"])}
    alone = [view.camera for view in usable if view.camera not in together]
    found += [
        Finding(
            False,
            f"{name}: sees nothing in a frame in which another camera does, and will be left out; check its frame numbers",
        )
        for name in alone
    ]
    starts, lengths = (
        {int(view.frames[0]) for view in usable},
        {len(view.frames) for view in usable},
    )
    if len(starts) == 2 and max(starts) - min(starts) == 1 and len(lengths) == 1:
        late = next(view.camera for view in usable if view.frames[0] == max(starts))
        remedy = f"say --frame-offset {late}:-1 for each such camera, if they count from 1"
        found.append(
            Finding(
                False,
                f"equally long recordings start at frame {min(starts)} and at frame {max(starts)} ({ranges}); {remedy}",
            )
        )
    elif len({(int(view.frames[0]), int(view.frames[-1])) for view in usable}) > 1:
        found.append(
            Finding(
                False,
                f"the cameras' frames differ ({ranges}); only frames that two of them have are used",
            )
        )
    return found


def _joints(
    usable: Sequence[Keypoints2D], report: Mapping[str, Any], meant: Mapping[str, str]
) -> list[Finding]:
    """Names that do not go together."""
    if len(usable) < 2:
        return []
    remedy = "give them one name in all files, or map them with --skeleton where they are joints of a model (docs/skeletons.md)"
    alone = alone_in_naming(usable, meant)
    shared = {
        meant[name]: name
        for view in reversed(usable)
        for name in view.keypoints
        if name not in alone
    }
    if not shared:
        listed = "; ".join(
            f"{view.camera}: {', '.join(view.keypoints[:_LISTED])}, ..." for view in usable
        )
        return [Finding(True, f"no two cameras share a keypoint name ({listed}); {remedy}")]
    found = [Finding(False, f"{said_of_alone(alone)}; {remedy}")] if alone else []
    try:
        check_shared(tuple(shared.values()))
    except MismatchError as error:
        return [Finding(True, str(error)), *found]
    if report["model"]["knows"] < LEAST_JOINTS:
        models = ", ".join(SHIPPED)
        remedy = "map those that are joints of a model with --skeleton (docs/skeletons.md)"
        found.append(
            Finding(
                False,
                f"the models ({models}) know {report['model']['knows']} of the joints: calibrated by geometry alone; {remedy}",
            )
        )
    return found


def alone_in_naming(views: Sequence[Keypoints2D], meant: Mapping[str, str]) -> dict[str, str]:
    """Name -> camera of the keypoints that a single view has; `meant` as by `recording.meanings`."""
    owners: dict[str, set[str]] = {}
    for view in views:
        for name in view.keypoints:
            owners.setdefault(meant[name], set()).add(view.camera)
    return {
        name: view.camera
        for view in views
        for name in view.keypoints
        if len(owners[meant[name]]) == 1
    }


def said_of_alone(alone: Mapping[str, str]) -> str:
    """A line on these, shortened."""
    listed = ", ".join(f"{name} ({camera})" for name, camera in list(alone.items())[:_LISTED]) + (
        ", ..." if len(alone) > _LISTED else ""
    )
    return f"{len(alone)} keypoints that a single camera names are not used: {listed}"


def _copies(usable: Sequence[Keypoints2D]) -> list[Finding]:
    """Two cameras with the same detections."""
    same = [
        (a, b)
        for a, b in combinations(usable, 2)
        if a.positions.shape == b.positions.shape
        and np.array_equal(a.positions, b.positions, equal_nan=True)
    ]
    return [
        Finding(
            True,
            f"{a.camera} and {b.camera} have the same detections ({a.source}, {b.source}); give each camera its own file",
        )
        for a, b in same
    ]


def _worse(view: Keypoints2D, config: InspectConfig) -> list[str]:
    """What makes a camera's detections worth less."""
    scores = view.confidence[_seen(view)]
    if not len(scores):
        return []
    found = []
    if np.median(scores) < config.low_confidence:
        found.append(
            f"{view.camera}: half of the scores are below {config.low_confidence}; check the detector's output"
        )
    if scores.max() > 1.0:
        found.append(
            f"{view.camera}: scores up to {scores.max():.2f} are no probabilities and will be scaled to 0-1; nothing to do if the detector writes such"
        )
    gone = int((np.diff(view.frames) - 1).sum())
    if gone > config.gaps * (gone + len(view.frames)):
        found.append(
            f"{view.camera}: {gone} frame numbers between the first and the last are not there; check that none were lost"
        )
    return found


def _with_cameras(
    views: Sequence[Keypoints2D],
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
) -> list[Finding]:
    """What a run would say of the keypoints and cameras together."""
    try:
        recording = make_recording(views, cameras, skeleton, aliases)
        check_joints(recording.select(frames=choose_sample_frames(recording, SampleConfig())))
        owners = {name for _, name in name_mapping(views, cameras)}
    except MismatchError as error:
        return [Finding(True, str(error))]
    idle = [camera.name for camera in cameras if camera.name not in owners]
    return (
        [
            Finding(
                False,
                f"{', '.join(idle)}: no keypoints for these cameras; add their files, or go on without them",
            )
        ]
        if idle
        else []
    )
