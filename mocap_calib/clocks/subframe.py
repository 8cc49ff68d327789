"""Settle what part of a frame the clocks of cameras are off by, for all that follows."""

from dataclasses import replace

from mocap_calib.clocks.in_step import bring_in_step
from mocap_calib.clocks.time_offsets import find_time_offsets
from mocap_calib.config import Config
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import hide_blind_spots
from mocap_calib.results import Adjusted, Matches, TimeOffsets
from mocap_calib.rig.observed import Observed


def settle_clocks(
    observed: Observed, adjusted: Adjusted, matches: Matches, config: Config
) -> tuple[Observed, Adjusted, TimeOffsets]:
    """Return what was seen at the time of the first camera, the rig that fits it, and the offsets.

    matches: labels in all frames of the recording. Where the clocks agree, or nothing tells
    whether they do, everything stays as it is.
    """
    recording = observed.recording
    offsets, rig = find_time_offsets(recording, adjusted.rig, matches, config)
    if not offsets.used.any():
        return observed, adjusted, offsets
    recording = bring_in_step(recording, rig, matches, offsets.applied, config.triangulate)
    recording = hide_blind_spots(recording)  # some may now lie beyond what the lens model knows
    sample = take_sample(recording, observed.sample_frames)
    in_step = replace(observed, recording=recording, sample=sample)
    return in_step, replace(adjusted, rig=rig), offsets
