"""Find cameras that saw another scene, or another time, than the others of their group.

Views of different rooms always find something alike, so such a camera may be placed by a pair of
low score; but hardly any of its detections lie where the others place the bodies.
"""

import numpy as np

from mocap_calib.adjust.resection import CameraPoses, costs_of, sightings_of
from mocap_calib.config import Config
from mocap_calib.results import Fault, GroupResult
from mocap_calib.rig.observed import Observed
from mocap_calib.rig.placed import PlacedCameras, choose_frames, place_bodies
from mocap_calib.types import Ints


def find_unrelated_cameras(
    observed: Observed, group: GroupResult, config: Config
) -> tuple[Fault, ...]:
    """Return a fault for each camera of a group that saw something else than the others.

    Other faults may look the same, so they are to be ruled out first. Of two cameras both would be
    unrelated to the other: none is named.
    """
    best = _best_scores(group)
    doubtful = np.flatnonzero(best < config.averaging.weak_score).tolist()
    if len(group.rig) <= 2 or not doubtful:
        return ()
    observed, placed = PlacedCameras.of_group(observed, group, config)
    frames = choose_frames(observed.sample, config.unrelated.detections, config)
    shares = np.array(
        [_explained(observed, placed, view, frames, config) for view in range(len(group.rig))]
    )
    faults = []
    for view in doubtful:
        usual = float(np.median(np.delete(shares, view)))
        if shares[view] < config.unrelated.most_explained * usual and (
            usual > config.unrelated.least_usual
        ):
            evidence = {
                "pair_score": float(best[view]),
                "explained": float(shares[view]),
                "explained_of_others": usual,
            }
            says = (
                "saw another scene, or another time, than the other cameras: "
                f"pair score {best[view]:.2f}, {shares[view]:.0%} of its detections explained"
            )
            faults.append(Fault(group.rig.names[view], "unrelated", says, evidence))
    return tuple(faults)


def _best_scores(group: GroupResult) -> np.ndarray:
    """Return the best pair score `[view]` of each camera."""
    best = np.zeros(len(group.rig))
    for pair in group.pairs:
        best[[pair.a, pair.b]] = np.maximum(best[[pair.a, pair.b]], pair.score)
    return best


def _explained(
    observed: Observed, placed: PlacedCameras, view: int, frames: Ints, config: Config
) -> float:
    """Return the share of a view's detections that bodies lie at which the others place."""
    least = config.moved.least_joints
    bodies = place_bodies(observed.sample, placed, frames, config, without=view)
    seen = sightings_of(observed.sample.rays[view][frames], bodies, least)
    if not len(seen.frame):
        return 0.0
    pose = CameraPoses(placed.rig.rotation[[view]], placed.rig.translation[[view]])
    cost = costs_of(pose, seen, config.unrelated.tolerance * seen.angular_size, least)
    return float((cost[0] < config.moved.explained).mean())
