"""Which frames of a recording are looked at."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PEOPLE, calibrate_group, recording, rotation_errors_deg, scene

from mocap_calib.config import SampleConfig
from mocap_calib.recording.sampling import choose_sample_frames, evenly_spaced, take_sample
from mocap_calib.recording.synchronise import make_recording

LONG = {"frames": 400, "people": 2, "cameras": 4, "seed": 2}


def test_an_even_choice_has_both_ends_and_no_more_than_there_are():
    assert evenly_spaced(np.arange(10, 110), 5).tolist() == [10, 34, 59, 84, 109]
    assert evenly_spaced(np.arange(3), 5).tolist() == [0, 1, 2]
    assert evenly_spaced(np.arange(0), 5).tolist() == []


def test_a_short_recording_is_its_own_sample():
    np.testing.assert_array_equal(choose_sample_frames(recording(), SampleConfig()), np.arange(60))


def test_the_sample_is_ascending_and_as_large_as_the_budget_allows():
    found = recording(**LONG)
    config = SampleConfig(detections=600, least_frames=10)
    sample_frames = choose_sample_frames(found, config)
    assert (np.diff(sample_frames) > 0).all()
    in_frame = found.seen.any(-1).sum((0, 2))
    assert len(sample_frames) == pytest.approx(600 / in_frame.mean(), rel=0.1)


def test_frames_of_a_pair_that_seldom_meets_are_chosen_and_empty_ones_are_not():
    """The first camera sees somebody in one frame of a hundred; in half of them nobody is seen.

    That frame is in a sample of ten.
    """
    found = recording(**LONG).select(frames=np.zeros(100, dtype=int))
    positions = found.positions.copy()
    positions[0, np.arange(100) != 57] = np.nan
    positions[:, ::2] = np.nan
    rare = replace(found, positions=positions, frames=np.arange(100))
    sample_frames = choose_sample_frames(rare, SampleConfig(detections=1, least_frames=10))
    assert len(sample_frames) == 10
    assert 57 in sample_frames
    assert (sample_frames % 2 == 1).all()


def test_rare_places_are_chosen():
    """A person, who otherwise stands, is in a corner of one image for one frame of a hundred.

    That frame is in a sample of ten.
    """
    found = recording(**LONG).select(frames=np.zeros(100, dtype=int))
    positions = found.positions.copy()
    positions[0, 57] += 300.0
    rare = replace(found, positions=positions, frames=np.arange(100))
    assert 57 in choose_sample_frames(rare, SampleConfig(detections=1, least_frames=10))


@pytest.mark.slow
def test_one_overcrowded_frame_costs_no_more_than_itself():
    """30 false detections in one frame of one camera, which is labelled all the same.

    The frame is not in the sample, whose arrays stay small.
    """
    made = scene(frames=60)
    files = list(made.files)
    rng = np.random.default_rng(0)
    wide = np.full((60, 34, *files[1].positions.shape[2:]), np.nan)
    wide[:, : files[1].positions.shape[1]] = files[1].positions
    wide[20, 4:] = rng.uniform(0, 700, (30, *wide.shape[2:]))
    sure = np.zeros(wide.shape[:3])
    sure[:, : files[1].positions.shape[1]] = files[1].confidence
    sure[20, 4:] = 0.5
    files[1] = replace(files[1], positions=wide, confidence=sure)
    found = make_recording(files, made.rig.cameras, PEOPLE, {})
    sample_frames = choose_sample_frames(found, SampleConfig())
    assert 20 not in sample_frames
    assert len(sample_frames) == 59
    assert take_sample(found, sample_frames).positions.shape[2] <= 5
    calibrated = calibrate_group(found)
    assert rotation_errors_deg(calibrated.rig, made.rig).max() < 0.15
    assert (calibrated.matches.labels[:, 20] >= 0).sum() >= 8
