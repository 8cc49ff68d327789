"""The rig of all cameras but one, and the points that these know."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.adjust.rig_covariance import rig_covariance
from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.alignment import changed_rig
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import RigCovariance
from mocap_calib.rig.associate import associate
from mocap_calib.rig.averaging import average, camera_groups
from mocap_calib.rig.large_rigs import takes_all_pairs
from mocap_calib.rig.observed import (
    Observed,
    PlacedCameras,
    leave_out_underconstrained,
    place_bodies,
)
from mocap_calib.rig.tracks import labelled_frames
from mocap_calib.types import CameraRig, Floats, Ints, Sample, silent


@dataclass(frozen=True)
class CoreRig:
    """Cameras that agree, and what they know.

    sample, placed: of these cameras. frames: `[frame]` indices into the sample of some frames.
    points: `[frame, individual, keypoint, 3]` in the rig's world, NaN = not known. Individuals are
        those of a frame, in any order.
    pair_score: mean over the pairs of the rig.
    """

    sample: Sample
    placed: PlacedCameras
    frames: Ints
    points: Floats
    pair_score: float

    @property
    def rig(self) -> CameraRig:
        """Of these cameras."""
        return self.placed.rig


def find_core_rig(observed: Observed, view: int, config: Config) -> CoreRig | None:
    """Return the rig of the cameras besides one (index); None where they make none.

    Of a large rig, of those that were paired with it: the others say little of what it saw.
    """
    others = _others(observed, view, config)
    rough = replace(
        config,
        adjust=replace(
            config.adjust, rounds=config.diagnosis.rounds, points=config.diagnosis.points
        ),
    )

    def build(some: Observed) -> CoreRig:
        """Return the rig of some cameras."""
        return _build_core(some, rough)

    try:
        group = camera_groups(others.recording.cameras, others.pairs, config.averaging)[0]
        return leave_out_underconstrained(others.select(group), build)
    except DegenerateError:
        return None


def _others(observed: Observed, view: int, config: Config) -> Observed:
    """Return what the cameras besides one saw, of a large rig those that were paired with it."""
    names = observed.recording.names
    if takes_all_pairs(len(names), config.view_graph):
        return observed.without(names[view])
    paired = [{pair.a, pair.b} - {view} for pair in observed.pairs if view in (pair.a, pair.b)]
    return observed.select(np.array(sorted(set().union(*paired)), dtype=np.int64))


def _build_core(observed: Observed, config: Config) -> CoreRig:
    """Return the rig of these cameras: average -> match -> adjust -> triangulate."""
    sample, lifted = observed.sample, observed.lifted
    averaged = average(observed.recording.cameras, observed.pairs, config.averaging)
    matches = associate(sample, lifted, averaged.rig, config, progress=silent)
    adjusted = adjust_until_stable(
        sample, averaged.rig, matches, config, lifted=lifted, progress=silent
    )
    placed = PlacedCameras.of(sample, adjusted.rig, adjusted.matches, config)
    frames = evenly_spaced(labelled_frames(placed.matches), config.diagnosis.frames)
    return CoreRig(
        sample=sample,
        placed=placed,
        frames=frames,
        points=place_bodies(sample, placed, frames, config),
        pair_score=float(np.mean([pair.score for pair in observed.pairs])),
    )


def core_covariance(core: CoreRig, config: Config) -> RigCovariance:
    """Return how sure the places of these cameras are."""
    return rig_covariance(core.sample, core.rig, core.placed.matches, config)


def is_determined(covariance: RigCovariance, config: Config, *, unknowns: bool) -> bool:
    """Return whether the rig is determined well enough for what it says of a camera.

    unknowns: whether that has some, which a rig that bends takes along. Whether images are
        mirrored or rotated, or sides exchanged, shows in every rig that the verdict does not call
        not determined.
    """
    limit = config.diagnosis.core_deg if unknowns else VERDICT_LIMITS_DEG[-1]
    return bool(np.rad2deg(covariance.rotation_sigma.max()) < limit)


def bent_points(
    core: CoreRig, covariance: RigCovariance, config: Config
) -> Iterator[tuple[float, Floats]]:
    """Yield a factor, and where the points of a core rig lie if the rig is off by a little.

    That is along each axis of its covariance in turn, the longest first. The factor is one standard
    deviation along the axis, as a multiple of how far the rig was moved. Points: as of the rig.
    """
    views = len(core.rig)
    variances, axes = np.linalg.eigh(covariance.matrix.reshape(6 * views, 6 * views))
    longest = np.argsort(-variances)[: config.diagnosis.axes]
    little = config.diagnosis.axis_step
    for variance, axis in zip(variances[longest], axes.T[longest], strict=True):
        placed = replace(core.placed, rig=changed_rig(core.rig, little * axis.reshape(views, 6)))
        times = np.sqrt(max(float(variance), 0.0)) / little
        yield times, place_bodies(core.sample, placed, core.frames, config)
