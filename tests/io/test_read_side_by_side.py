"""HDF5 files are read side by side, others one at a time; what comes of them is in order."""

from dataclasses import replace
from pathlib import Path
from threading import Barrier, Lock

import numpy as np
import pytest

from mocap_calib.io import sandbox
from mocap_calib.io.keypoints import coco_writer, deeplabcut_writer, read
from mocap_calib.types import Keypoints2D

pytestmark = pytest.mark.usefixtures("two_processors")


def view(camera: str) -> Keypoints2D:
    rng = np.random.default_rng(len(camera) + ord(camera[-1]))
    return Keypoints2D(
        camera=camera,
        keypoints=("nose", "left_hip", "right_hip"),
        frames=np.arange(20),
        positions=rng.uniform(10, 500, (20, 1, 3, 2)),
        confidence=np.ones((20, 1, 3)),
        source=camera,
        tracked=True,
        image_size=(640, 480),
    )


def write(folder: Path, *names: str) -> list[Path]:
    """Write a file per camera: .h5 as DeepLabCut has it, .json as COCO."""
    for name in names:
        writer = deeplabcut_writer.write_h5 if name.endswith("h5") else coco_writer.write
        (content,) = writer((replace(view(Path(name).stem), source=""),)).values()
        (folder / name).write_bytes(content)
    return [folder / name for name in names]


def test_order_stays_and_errors_are_collected(tmp_path, monkeypatch):
    monkeypatch.setattr(sandbox, "_LARGE", 0)
    paths = write(tmp_path, "a.h5", "b.h5", "c.h5", "d.h5")
    paths[1].write_bytes(paths[1].read_bytes()[:3000])
    views, errors = read.read_what_can(paths)
    assert [found.camera for found in views] == ["a", "c", "d"]
    assert [str(error).startswith(str(paths[1])) for error in errors] == [True]
    for found in views:
        np.testing.assert_allclose(found.positions, view(found.camera).positions)


def test_two_files_of_hdf5_are_under_way_at_once(tmp_path, monkeypatch):
    paths = write(tmp_path, "a.h5", "b.h5")
    both, plain = Barrier(2, timeout=120), read._read_contained

    def wait(*given):
        both.wait()
        return plain(*given)

    monkeypatch.setattr(read, "_read_contained", wait)
    assert len(read.read_what_can(paths)[0]) == 2


def test_others_are_held_one_at_a_time(tmp_path, monkeypatch):
    paths = write(tmp_path, "a.h5", "b.json", "c.json", "d.h5", "e.json")
    held, plain = Lock(), read._read_contained

    def hold(item, *given):
        if item.path.suffix != ".json":
            return plain(item, *given)
        assert held.acquire(blocking=False)
        try:
            return plain(item, *given)
        finally:
            held.release()

    monkeypatch.setattr(read, "_read_contained", hold)
    views, errors = read.read_what_can(paths)
    assert not errors
    assert [found.camera for found in views] == list("abcde")
