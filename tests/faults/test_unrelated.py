"""Cameras of another recording form a group of their own, or a rig that is not determined."""

from dataclasses import replace

import pytest
from scenes import PEOPLE, calibrate_all, scene

from mocap_calib.recording.synchronise import make_recording


def put_together(first, second, views: int, others: int):
    """The recording of some cameras of one scene and of some of another one."""
    files, cameras = [], []
    for made, tag, count in ((first, "A", views), (second, "B", others)):
        for file, camera in list(zip(made.files, made.rig.cameras, strict=True))[:count]:
            files.append(replace(file, camera=tag + file.camera, source=tag + file.source))
            cameras.append(replace(camera, name=tag + camera.name))
    return make_recording(files, cameras, PEOPLE, {})


@pytest.mark.slow
def test_a_camera_of_another_recording_makes_no_rig_to_measure_with():
    """No camera is accused of it."""
    together = put_together(scene(people=2), scene(people=2, seed=1), 3, 1)
    result = calibrate_all(together)
    (stranger,) = (name for name in together.names if name.startswith("B"))
    assert {fault.camera for fault in result.faults} <= {stranger}
    assert all(
        group.verdict in ("weak", "not determined")
        for group in result.groups
        if stranger in group.rig.names
    )


@pytest.mark.slow
def test_two_and_two_cameras_of_two_recordings_are_two_groups():
    together = put_together(scene(people=2), scene(people=2, seed=1), 2, 2)
    result = calibrate_all(together)
    for group in result.groups:
        assert len({name[0] for name in group.rig.names}) == 1 or group.verdict != "well determined"
