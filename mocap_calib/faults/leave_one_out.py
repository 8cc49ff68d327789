"""The leave-one-out rig: of all cameras but one, and the points that it places."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.adjust.rig_covariance import rig_covariance
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.alignment import changed_rig
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import RigCovariance
from mocap_calib.rig.associate import associate
from mocap_calib.rig.averaging import average
from mocap_calib.rig.graph import camera_groups
from mocap_calib.rig.large_rigs import takes_all_pairs
from mocap_calib.rig.observed import Observed, leave_out_underconstrained
from mocap_calib.rig.placed import PlacedCameras, place_bodies
from mocap_calib.rig.tracks import labelled_frames
from mocap_calib.types import CameraRig, Floats, Ints, Sample, silent


@dataclass(frozen=True)
class OtherCameras:
    """The leave-one-out rig of a camera.

    sample, placed: of the other cameras. frames: `[frame]` indices into the sample of some frames.
    points: `[frame, individual, keypoint, 3]` in the rig's world, NaN = not placed. Individuals are
        those of a frame, in any order.
    covariance: of the rig. pair_score: mean over the pairs of the rig.
    """

    sample: Sample
    placed: PlacedCameras
    frames: Ints
    points: Floats
    covariance: RigCovariance
    pair_score: float

    @property
    def rig(self) -> CameraRig:
        """Of these cameras."""
        return self.placed.rig


def leave_out(observed: Observed, view: int, config: Config) -> OtherCameras | None:
    """Return the leave-one-out rig of a view (index); None where the others determine no rig.

    In a large rig the others are those that were paired with the view.
    """
    others = _others(observed, view, config)
    rough = replace(config, adjust=replace(config.adjust, rounds=1, points=4000))

    def build(some: Observed) -> OtherCameras:
        """Return the rig of some cameras."""
        return _build(some, rough)

    try:
        group = camera_groups(others.recording.cameras, others.pairs, config.averaging)[0]
        found = leave_out_underconstrained(others.select(group), build)
    except DegenerateError:
        return None
    sigma = np.rad2deg(found.covariance.rotation_sigma.max())
    return found if sigma < config.diagnosis.core_deg else None


def _others(observed: Observed, view: int, config: Config) -> Observed:
    """Return what the other cameras saw, in a large rig those that were paired with the view."""
    names = observed.recording.names
    if takes_all_pairs(len(names), config.view_graph):
        return observed.without(names[view])
    paired = [{pair.a, pair.b} - {view} for pair in observed.pairs if view in (pair.a, pair.b)]
    return observed.select(np.array(sorted(set().union(*paired)), dtype=np.int64))


def _build(observed: Observed, config: Config) -> OtherCameras:
    """Return the rig of these cameras: average -> match -> adjust -> triangulate."""
    sample, lifted = observed.sample, observed.lifted
    averaged = average(observed.recording.cameras, observed.pairs, config.averaging)
    matches = associate(sample, lifted, averaged.rig, config, progress=silent)
    adjusted = adjust_until_stable(
        sample, averaged.rig, matches, config, lifted=lifted, progress=silent
    )
    placed = PlacedCameras.of(sample, adjusted.rig, adjusted.matches, config)
    frames = evenly_spaced(labelled_frames(placed.matches), config.diagnosis.frames)
    return OtherCameras(
        sample=sample,
        placed=placed,
        frames=frames,
        points=place_bodies(sample, placed, frames, config),
        covariance=rig_covariance(sample, placed.rig, placed.matches, config)[0],
        pair_score=float(np.mean([pair.score for pair in observed.pairs])),
    )


def bent_points(others: OtherCameras, config: Config) -> list[tuple[float, Floats]]:
    """Return points of slightly bent rigs, along the longest axes of the rig's covariance.

    Each with one standard deviation along its axis, as a multiple of how far the rig was bent.
    """
    views, little = len(others.rig), 1e-4  # radians and sizes of the rig: for slopes
    variances, axes = np.linalg.eigh(others.covariance.matrix.reshape(6 * views, 6 * views))
    bent = []
    for variance, axis in zip(variances[:-25:-1], axes.T[:-25:-1], strict=True):
        rig = changed_rig(others.rig, little * axis.reshape(views, 6))
        placed = replace(others.placed, rig=rig)
        points = place_bodies(others.sample, placed, others.frames, config)
        bent.append((np.sqrt(max(float(variance), 0.0)) / little, points))
    return bent
