"""The rig of all cameras but one, and the points that these know."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.multi_view.association import associate
from mocap_calib.multi_view.averaging import average
from mocap_calib.multi_view.observations import labelled_frames
from mocap_calib.multi_view.observed import Observed, leave_out_underconstrained
from mocap_calib.multi_view.pair_choice import takes_all_pairs
from mocap_calib.multi_view.placed import PlacedCameras, place_bodies
from mocap_calib.multi_view.refinement import adjust_until_stable
from mocap_calib.multi_view.rig_covariance import rig_covariance
from mocap_calib.multi_view.view_graph import camera_groups
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import CameraRig, Floats, Ints, Matches, Sample, silent


@dataclass(frozen=True)
class CoreRig:
    """Cameras that agree, and what they know.

    sample, matches: of these cameras. frames: `[frame]` indices into the sample of some frames.
    points: `[frame, individual, keypoint, 3]` in the rig's world, NaN = not known. Individuals are
        those of a frame, in any order.
    pair_score: mean over the pairs of the rig.
    """

    sample: Sample
    rig: CameraRig
    matches: Matches
    frames: Ints
    points: Floats
    pair_score: float


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
        rig=placed.rig,
        matches=placed.matches,
        frames=frames,
        points=place_bodies(sample, placed, frames, config),
        pair_score=float(np.mean([pair.score for pair in observed.pairs])),
    )


def is_determined(core: CoreRig, config: Config, *, seed: int) -> bool:
    """Return whether what was seen determines the rig, by the yardstick of the verdict."""
    found = rig_covariance(core.sample, core.rig, core.matches, config, seed=seed)
    return bool(np.rad2deg(found.rotation_sigma.max()) < config.diagnosis.core_deg)
