"""Finish an adjusted rig: its covariance, the points of the bodies, and the checks."""

from dataclasses import replace

import numpy as np

from mocap_calib.compute.clock import Clock
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config
from mocap_calib.pairs.solve import in_recording
from mocap_calib.results import (
    Adjusted,
    Averaged,
    CalibrationResult,
    Clocks,
    GroupResult,
    LiftedPoses,
    Matches,
    TimeOffsets,
)
from mocap_calib.rig.observed import Observed
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import CameraRig, Progress, Sample, silent
from mocap_calib.verdict.checks import check_rig
from mocap_calib.verdict.uncertainty import assess_uncertainty
from mocap_calib.verdict.verdict import assess, judge


def conclude(
    observed: Observed,
    averaged: Averaged,
    adjusted: Adjusted,
    matches: Matches,
    offsets: TimeOffsets,
    *,
    config: Config,
    clock: Clock,
    progress: Progress,
) -> GroupResult:
    """Assess an adjusted rig and triangulate the bodies; return all that was found.

    matches: labels in all frames of the recording. offsets: of the clocks, with which the
        recording and the sample were made. clock: its stages, and those of before, are returned.
    """
    recording, sample, rig = observed.recording, observed.sample, adjusted.rig
    with clock("uncertainty"):
        sampled = matches.select(frames=observed.sample_frames, instances=sample.positions.shape[2])
        uncertainty = assess_uncertainty(sample, rig, sampled, config)
    with clock("triangulate"):
        poses = triangulate(recording, rig, matches, config.triangulate, progress=progress)
    group = GroupResult(
        recording=recording,
        pairs=in_recording(observed.pairs, observed.sample_frames),
        averaged=averaged,
        adjusted=adjusted,
        matches=matches,
        uncertainty=uncertainty,
        poses=poses,
        time_offsets=offsets,
    )
    with clock("verdict"):
        verdict = assess(group, check_rig(group, config), config)
    return replace(group, assessment=verdict, seconds=clock.seconds)


@single_threaded_libraries()
def conclude_without_pairs(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    adjusted: Adjusted,
    config: Config,
) -> CalibrationResult:
    """Return what `conclude` finds of the frames of a sample alone, where no pairs are known.

    rig: that was adjusted.
    """
    no_pairs = np.zeros(0)
    group = conclude(
        Observed(
            recording=sample,
            sample_frames=np.arange(len(sample.frames)),
            sample=sample,
            lifted=lifted,
            pairs=(),
        ),
        Averaged(rig, loop_error=no_pairs, translation_error=no_pairs, weight=no_pairs),
        adjusted,
        adjusted.matches,
        TimeOffsets.unknown(len(rig)),
        config=config,
        clock=Clock(),
        progress=silent,
    )
    return judge(
        CalibrationResult(
            groups=(group,),
            left_out=(),
            unused_pairs=(),
            config=config,
            seed=0,
            clocks=Clocks.of_one(sample),
        )
    )
