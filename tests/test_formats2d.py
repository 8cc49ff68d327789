"""The table of keypoint formats: what is written reads equal, one recording reads equal in all of them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_calib.io.formats2d import read_keypoints, write_keypoints
from mocap_calib.types import Keypoints2D

NAMES = ("nose", "left eye", "tail,base")


def view(camera="cam1", frames=(3, 4, 10), instances=2, missing=0.3, tracked=True, size=(0, 0), seed=0):
    """Random detections; the first frame has all points, so that nobody is without any."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(1, 400, (len(frames), instances, len(NAMES), 2))
    confidence = rng.uniform(0.1, 0.99, positions.shape[:3])
    gone = rng.random(confidence.shape) < missing
    gone[0] = False
    positions[gone], confidence[gone] = np.nan, 0.0
    return Keypoints2D(camera, NAMES, np.array(frames, dtype=np.int64), positions, confidence, tracked, size, "made")


def assert_equal(found: Keypoints2D, wanted: Keypoints2D, atol=0.0):
    assert (found.camera, found.keypoints, found.tracked) == (wanted.camera, wanted.keypoints, wanted.tracked)
    np.testing.assert_array_equal(found.frames, wanted.frames)
    np.testing.assert_allclose(found.positions, wanted.positions, rtol=0, atol=atol)
    np.testing.assert_allclose(found.confidence, wanted.confidence, rtol=0, atol=atol)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.booleans(), st.integers(1, 3), st.floats(0, 1))
def test_csv_reads_what_it_wrote(tmp_path_factory, seed, tracked, instances, missing):
    path = tmp_path_factory.mktemp("csv") / "keypoints.csv"
    views = tuple(view(name, frames, instances, missing, tracked, seed=seed) for name, frames in (("left", (0, 5, 6)), ('a "b", c', (2, 3))))
    write_keypoints(path, views, "csv")
    for found, wanted in zip(read_keypoints([path]), views, strict=True):
        assert_equal(found, wanted)
