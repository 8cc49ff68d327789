"""Hold a unit that somebody states to the size of the people who are seen."""

import numpy as np

from mocap_calib.config import CueConfig
from mocap_calib.errors import MismatchError
from mocap_calib.types import METRES, Floats
from mocap_calib.world.body import distance, median_over_frames, quantile_over_frames
from mocap_calib.world.cues import Measurable
from mocap_calib.world.moving import Similarity

_METRES = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048}


def check_people(
    on: Measurable, by: Similarity, unit: str, option: str, config: CueConfig
) -> tuple[str, ...]:
    """Return a remark where people would be too small in a stated world, none where all is well.

    by: the way there. unit: of lengths in it. option: that states it.

    Raises MismatchError where they would be taller than anybody is.
    """
    seen = _tallness(on, config)
    if not len(seen):
        return ()
    tall = METRES[unit] * by.scale * float(np.median(seen))
    if tall > config.statures[1]:
        raise MismatchError(
            f"{option}: expected lengths in {unit}, found people {tall:.4g} m tall; "
            f"{_likely_unit(tall, config)}"
        )
    if tall < config.least_tall:
        return (f"people are {tall:.2g} m tall: is {option} in {unit}?",)
    return ()


def _tallness(on: Measurable, config: CueConfig) -> Floats:
    """Return how far heads are from ankles `[N]` of all whose are seen, about a stature."""
    joints, positions = on.joints, on.poses.positions
    ankles = joints.present(("left_ankle", "right_ankle"))
    if joints.kind != "people":
        return np.zeros(0)
    found = [np.full(positions.shape[1], np.nan)]
    for name, share in config.head_height:
        for head in joints.present([name]):
            for ankle in ankles:
                apart = distance(positions, head, ankle) / share
                enough = np.isfinite(apart).sum(0) >= config.least_frames
                far = quantile_over_frames(apart, config.tall_quantile)
                found.append(np.where(enough, far, np.nan))
    tall = median_over_frames(np.array(found))
    return tall[np.isfinite(tall)]


def _likely_unit(tall: float, config: CueConfig) -> str:
    """Return what to do about lengths that make people so many metres tall."""
    least, most = config.statures
    fits = {name: tall * metres for name, metres in _METRES.items()}
    fits = {name: metres for name, metres in fits.items() if least <= metres <= most}
    if not fits:
        return "correct the lengths"
    name = min(fits, key=lambda each: abs(np.log(fits[each] / config.usual_stature)))
    return f"were {name} meant? multiply them by {_METRES[name]:g}"
