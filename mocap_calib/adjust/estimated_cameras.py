"""Estimate the intrinsics of all cameras of a recording, each group by a rig of its own."""

from functools import partial

from mocap_calib.adjust.intrinsics import estimate_intrinsics, not_estimated
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.rig.associate import associate
from mocap_calib.rig.averaging import average
from mocap_calib.rig.graph import camera_groups
from mocap_calib.rig.observed import Observed, leave_out_underconstrained
from mocap_calib.types import EstimatedCamera, Progress


def estimate_cameras(
    observed: Observed, config: Config, *, progress: Progress
) -> tuple[EstimatedCamera, ...]:
    """Return all cameras with the intrinsics estimated from the rig of their group.

    Cameras of which nothing can be estimated stay as they were given.
    """
    cameras = observed.recording.cameras
    estimated: dict[str, EstimatedCamera] = {}
    for views in camera_groups(cameras, observed.pairs, config.averaging):
        estimate = partial(_estimate_group, config=config, progress=progress)
        try:
            found = leave_out_underconstrained(observed.select(views), estimate)
        except DegenerateError:
            continue
        estimated |= {camera.name: camera for camera in found}
    return tuple(
        estimated.get(camera.name) or not_estimated(camera, config.intrinsics) for camera in cameras
    )


def _estimate_group(
    observed: Observed, *, config: Config, progress: Progress
) -> tuple[EstimatedCamera, ...]:
    """Return the cameras of one group with intrinsics from a rig of theirs."""
    averaged = average(observed.recording.cameras, observed.pairs, config.averaging)
    matches = associate(observed.sample, observed.lifted, averaged.rig, config, progress=progress)
    return estimate_intrinsics(
        observed.sample, averaged.rig, matches, config, lifted=observed.lifted, progress=progress
    )
