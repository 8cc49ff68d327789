"""Faults that rival each other, or that only several cameras show."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from faults.test_fault_hypotheses import CHANGES, plain
from scenes import calibrate_all, rotation_errors_deg, scene

from mocap_calib.faults.mend import _sides_of_others
from mocap_calib.recording.corrections import Mirrored, Sides
from mocap_calib.results import Fault
from mocap_calib.types import Camera, Recording

ZOOM = 1.15


def zoomed(camera: Camera) -> Camera:
    """Return a camera with a longer lens and the same middle of its images."""
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= ZOOM
    return replace(camera, matrix=matrix)


def with_a_zoom(given: Recording, view: int, *, exchanged_with: int) -> Recording:
    """Give a camera a longer lens, and its intrinsics to another one, which gets those before."""
    middle = given.cameras[view].matrix[:2, 2]
    positions, cameras = given.positions.copy(), list(given.cameras)
    positions[view] = middle + ZOOM * (positions[view] - middle)
    other = cameras[exchanged_with]
    cameras[exchanged_with] = replace(zoomed(other), name=other.name)
    return replace(given, positions=positions, cameras=tuple(cameras))


@pytest.mark.slow
def test_two_cameras_with_the_intrinsics_of_each_other_are_named_and_mended():
    """Focal lengths that differ by 15 %; the median error after the mend, measured 0.7 deg."""
    changes = {**CHANGES, "people": 2}
    given = plain(people=2)
    result = calibrate_all(with_a_zoom(given, 0, exchanged_with=2))
    assert {(fault.camera, fault.word) for fault in result.faults} == {
        (given.names[0], "exchanged"),
        (given.names[2], "exchanged"),
    }
    assert all(fault.evidence["nats"] > 4 for fault in result.faults)
    errors = rotation_errors_deg(result.groups[0].rig, scene(**changes).rig)
    assert np.median(errors) < 1.0


@pytest.mark.slow
def test_a_world_in_the_mirror_is_not_well_determined():
    """Of three cameras two have left and right exchanged; with all mirrored, all fits as well."""
    given = plain(cameras=3, people=3)
    damaged = given
    for view in (0, 2):
        damaged = Sides(given.names[view]).apply(damaged)
    result = calibrate_all(damaged)
    assert sum(fault.word == "mirrored" for fault in result.faults) <= 1
    assert result.groups[0].verdict in ("weak", "not determined")


def known(names: tuple[str, ...], spread: list[float]) -> SimpleNamespace:
    """Return what is known of cameras of whose bodies the network is unsure by so much."""
    shape = (len(names), 5, 1, 17)
    lifted = SimpleNamespace(spread=np.broadcast_to(np.reshape(spread, (-1, 1, 1, 1)), shape))
    return SimpleNamespace(recording=SimpleNamespace(names=names), lifted=lifted)


def test_of_three_cameras_the_two_whose_bodies_look_odd_have_exchanged_sides():
    """Geometry blames the one that differs; its bodies look odd when its sides are exchanged."""
    names = ("a", "b", "c")
    fault = Fault("a", "sides", "left and right exchanged", {"gain": 0.2}, Sides("a"))
    before, worse, better = (known(names, [spread, 0.3, 0.3]) for spread in (0.3, 0.33, 0.27))
    found = _sides_of_others([fault], before, worse)
    assert [(each.camera, each.mend) for each in found] == [(n, Sides(n)) for n in ("b", "c")]
    assert all(each.evidence["spread"] == pytest.approx(np.log(1.1)) for each in found)
    assert _sides_of_others([fault], before, better) == ()
    other = replace(fault, camera="b", mend=Mirrored("b"))
    assert _sides_of_others([fault, other], before, worse) == ()


def test_of_four_cameras_two_may_have_exchanged_sides_but_not_three():
    """One that differs from three is wrong, whatever its bodies look like."""
    four = ("a", "b", "c", "d")
    before, worse = known(four, [0.3] * 4), known(four, [0.4] * 4)
    a, b = (Fault(name, "sides", "left and right exchanged", {}, Sides(name)) for name in "ab")
    assert _sides_of_others([a], before, worse) == ()
    assert [each.camera for each in _sides_of_others([a, b], before, worse)] == ["c", "d"]
