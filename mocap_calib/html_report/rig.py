"""The rig of a report, and another one that is laid over it."""

from pathlib import PurePath
from typing import Any

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import angle_between, rig_size
from mocap_calib.html_report.source import Reference, ReportSource
from mocap_calib.recording.epochs import list_epochs, views_by_camera
from mocap_calib.types import CameraRig, Floats, PosedCamera
from mocap_calib.verdict.evaluation import lay_over


def describe_rig(source: ReportSource) -> dict[str, Any]:
    """Return the cameras, the floor and the uncertainty of the centres for a page."""
    rig = source.rig
    camera_of = {
        view: number
        for number, views in enumerate(views_by_camera(rig.names).values())
        for view in views
    }
    epochs = list_epochs(rig.names, source.poses.frames)
    holding = [[epoch for epoch in epochs if view in epoch.views] for view in range(len(rig))]
    return {
        "unit": rig.unit,
        "up": _flat_if_known(rig.world.up),
        "floor": _flat_if_known(rig.world.floor),
        "size": rig_size(rig),
        "covariance": "axes" if source.directed else "spheres",
        "cameras": [
            {
                **_describe_camera(camera),
                "camera": camera_of[view],
                "first": min((epoch.first for epoch in holding[view]), default=0),
                "last": max((epoch.last for epoch in holding[view]), default=0),
                "covariance": _flat_if_known(source.covariance[view]),
            }
            for view, camera in enumerate(rig)
        ],
    }


def describe_reference(reference: Reference, rig: CameraRig) -> dict[str, Any]:
    """Return another rig as it lies over a rig after the best similarity, and how far it is off.

    Raises MismatchError where they have fewer than two cameras in common.
    """
    names = [name for name in rig.names if name in reference.rig]
    if len(names) < 2:
        raise MismatchError(
            reference.title,
            f"at least two cameras of {', '.join(rig.names)}",
            ", ".join(reference.rig.names),
            "match their names",
        )
    other = lay_over(reference.rig, rig, names)
    ours, theirs = rig.select(names), other.select(names)
    turned = np.degrees(angle_between(ours.rotation, theirs.rotation))
    shifted = np.linalg.norm(ours.centres - theirs.centres, axis=1)
    size = rig_size(ours)
    return {
        "title": PurePath(reference.title).name or reference.title,
        "cameras": [{**_describe_camera(camera), "covariance": None} for camera in other],
        "errors": [
            {
                "name": name,
                "rotation_deg": float(angle),
                "centre_percent": float(100 * distance / size),
                "centre": float(distance),
            }
            for name, angle, distance in zip(names, turned, shifted, strict=True)
        ],
    }


def _describe_camera(camera: PosedCamera) -> dict[str, Any]:
    """Return the lens of a camera and where it stands."""
    return {
        "name": camera.name,
        "size": list(camera.size),
        "matrix": camera.matrix.ravel().tolist(),
        "distortion": camera.distortion.tolist(),
        "fisheye": camera.fisheye,
        "rotation": camera.rotation.ravel().tolist(),
        "translation": camera.translation.tolist(),
    }


def _flat_if_known(values: Floats) -> list[float] | None:
    """Return numbers, row by row; None where they are not known."""
    return values.ravel().tolist() if np.isfinite(values).all() else None
