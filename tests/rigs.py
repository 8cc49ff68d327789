"""Rigs of all kinds, as a strategy, and when two of them are the same."""

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_calib.types import Camera, CameraRig

LENGTHS = (0, 4, 5, 8)
PLAIN = st.text("abcxyzABC0123456789_-", min_size=1, max_size=8)


@st.composite
def rigs(
    draw,
    lengths=LENGTHS,
    fisheye=True,
    names=PLAIN,
    square=False,
    units=("m", "mm", "cm", "arbitrary"),
):
    """1 to 5 cameras of any rotation, odd intrinsics, distortions of the `lengths` (0: none), some
    of them fisheyes.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    called = draw(st.lists(names, min_size=1, max_size=5, unique_by=str.lower))
    cameras = []
    for name in called:
        fish = fisheye and draw(st.booleans())
        count = 4 if fish else draw(st.sampled_from(lengths))
        fx, fy = 10.0 ** rng.uniform(0, 6, size=2)
        matrix = np.array(
            [[fx, 0, rng.normal() * 1e3], [0, fx if square else fy, rng.normal() * 1e3], [0, 0, 1]]
        )
        lens = rng.normal(size=count) * 10.0 ** rng.integers(-9, 3) if count else np.zeros(5)
        cameras.append(
            Camera(name, tuple(int(n) for n in rng.integers(1, 10_000, size=2)), matrix, lens, fish)
        )
    turns = st.sampled_from([(0.0, 0.0, 0.0), (np.pi, 0.0, 0.0), tuple(rng.normal(size=3))])
    vectors = [draw(turns) for _ in cameras]
    offsets = rng.normal(size=(len(cameras), 3)) * 10.0 ** rng.integers(-3, 5)
    rotation = Rotation.from_rotvec(np.array(vectors)).as_matrix()
    return CameraRig(tuple(cameras), rotation, offsets, draw(st.sampled_from(units)))


def padded(camera):
    """Its distortion with the zeros that formats add."""
    return np.concatenate([camera.distortion, np.zeros(8)])[:8]


def assert_same(rig, back, *, sizes=True, names=True, scale=1.0):
    """The rigs are one: exact but for the rounding of a rotation vector, a quaternion, a centre,
    half a pixel, or a unit.
    """
    assert len(rig.cameras) == len(back.cameras)
    for one, other in zip(rig.cameras, back.cameras, strict=True):
        assert one.fisheye == other.fisheye
        assert one.name == other.name or not names
        assert other.size == (one.size if sizes else (0, 0))
        np.testing.assert_allclose(other.matrix, one.matrix, rtol=1e-14, atol=1e-12)
        np.testing.assert_array_equal(padded(other), padded(one))
    np.testing.assert_allclose(back.rotation, rig.rotation, rtol=0, atol=2e-14)
    far = np.abs(rig.translation).max() + 1e-300
    np.testing.assert_allclose(
        back.translation, rig.translation * scale, rtol=0, atol=4e-15 * far * scale
    )


def unit(vectors: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return vectors of length 1."""
    return vectors / np.linalg.norm(vectors, axis=axis, keepdims=True)


def random_rotations(rng: np.random.Generator, count: int, largest: float = np.pi) -> np.ndarray:
    """Return rotations `[count, 3, 3]` about random axes, by up to `largest` radians."""
    axis = unit(rng.normal(size=(count, 3)))
    return Rotation.from_rotvec(axis * rng.uniform(0, largest, (count, 1))).as_matrix()


def rig_looking_at_origin(centres) -> CameraRig:
    """Return upright cameras at centres `[view, 3]` that look at the origin."""
    centres = np.array(centres, dtype=np.float64)
    forward = -unit(centres)
    right = unit(np.cross(forward, [0.0, 0.0, 1.0]))
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix = np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]])
    cameras = tuple(Camera(str(k), (1000, 1000), matrix) for k in range(len(centres)))
    return CameraRig(cameras, rotation, -np.einsum("vij,vj->vi", rotation, centres), "m")
