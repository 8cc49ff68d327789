"""Long recordings and many threads.

The rig comes of a sample, labels and poses of all frames, and threads change nothing.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import calibrate_group, precision, recording, rotation_errors_deg, scene, truth

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config, SampleConfig, TriangulateConfig
from mocap_calib.lift import lift
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.recording.sampling import take_sample
from mocap_calib.rig import gather_tracks
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.training import on_device
from mocap_calib.types import silent

LONG = {"frames": 400, "people": 2, "cameras": 4, "seed": 2}


# --- samples and blocks


@pytest.mark.slow
def test_a_long_recording_is_calibrated_by_its_sample_and_labelled_throughout():
    """60 of 400 frames are lifted, and each person keeps one name.

    Measured: 0.08 deg at most, precision 1.000, 99.6 % of the detections.
    """
    made, found = scene(**LONG), recording(**LONG)
    config = replace(Config(), sample=SampleConfig(detections=450, least_frames=60))
    result = calibrate_group(found, config=config)
    assert len(np.unique(np.concatenate([pair.matches[:, 0] for pair in result.pairs]))) <= 60
    assert rotation_errors_deg(result.rig, made.rig).max() < 0.3
    labels = result.matches.labels
    assert precision(labels, made.identity) > 0.995
    assert (labels[made.identity >= 0] >= 0).mean() > 0.97
    for person in range(2):
        own = labels[(made.identity == person) & (labels >= 0)]
        assert (own == np.bincount(own).argmax()).mean() > 0.98


def test_triangulation_is_a_function_of_blocks():
    """A point comes out the same whatever points are beside it: measured to the last digit."""
    rig, found, noise = (
        scene().rig,
        gather_tracks(recording(), truth(), np.arange(60)),
        np.full(4, 2e-3),
    )
    whole, used = triangulate_rays(
        rig, found.rays, weight=found.weight, noise=noise, config=TriangulateConfig()
    )
    part, of_part = triangulate_rays(
        rig,
        found.rays[..., 700:901],
        weight=found.weight[:, 700:901],
        noise=noise,
        config=TriangulateConfig(),
    )
    np.testing.assert_allclose(part, whole[:, 700:901], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(of_part, used[:, 700:901])


# --- threads


def test_results_come_in_order(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert list(map_in_threads(lambda k: k * k, range(50))) == [k * k for k in range(50)]
    with pytest.raises(ZeroDivisionError):
        list(map_in_threads(lambda k: 1 // k, range(3)))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_lifting_on_a_gpu_is_lifting():
    found = take_sample(recording(), slice(0, 5))
    first, second = (
        lift(found, on_device(load_lifter()[0], device), progress=silent)
        for device in ("cpu", "cuda")
    )
    np.testing.assert_allclose(second.body, first.body, atol=1e-3)
