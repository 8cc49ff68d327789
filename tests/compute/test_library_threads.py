"""BLAS stays on one thread in what Python users call, and is given back afterwards."""

import threading

import numpy as np
import pytest
from scenes import lifted, recording, scene, truth
from threadpoolctl import threadpool_info, threadpool_limits

from mocap_calib.adjust import refine
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config, PairwiseConfig
from mocap_calib.pairs import solve
from mocap_calib.poses import stage
from mocap_calib.rig import associate
from mocap_calib.rig import triangulate as triangulation
from mocap_calib.types import silent


def blas_threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    """As in a Python program of a user's; the tests themselves run on one."""
    with threadpool_limits(2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip("no BLAS here whose threads can be told")
        yield


class SeenError(Exception):
    """Raised by the stand-in for a step of a stage, with how many threads it saw."""


def look(*_, **__):
    raise SeenError(blas_threads())


def pairs():
    rng = np.random.default_rng(0)
    solve.calibrate_pairs(recording(), lifted(), PairwiseConfig(), rng=rng, progress=silent)


def match():
    associate.associate(recording(), lifted(), scene().rig, Config(), progress=silent)


def adjust():
    refine.adjust_once(recording(), scene().rig, truth(), Config())


def triangulate():
    triangulation.triangulate(recording(), scene().rig, truth())


def smooth():
    stage.smooth_poses(recording(), scene().rig, truth(), None)


STAGES = [  # a call, and a step of it, in its module
    (pairs, solve, "_gather"),
    (match, associate, "_measure_pose_ratio"),
    (adjust, refine, "choose_problem"),
    (triangulate, triangulation, "view_noise"),
    (smooth, stage, "view_noise"),
]


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize(("call", "module", "step"), STAGES)
def test_a_stage_called_from_python_holds_blas_to_one_thread(call, module, step, monkeypatch):
    monkeypatch.setattr(module, step, look)
    with pytest.raises(SeenError) as seen:
        call()
    assert seen.value.args == ({1},)
    assert blas_threads() == {2}


@pytest.mark.usefixtures("two_threads")
def test_the_first_to_begin_may_be_the_first_to_end():
    """Of two calls on two threads: the second still has one, and all get back what there was."""
    began, ended = threading.Event(), threading.Event()

    def first():
        with single_threaded_libraries():
            began.wait(5)
        ended.set()

    thread = threading.Thread(target=first)
    thread.start()
    with single_threaded_libraries():
        began.set()
        assert ended.wait(5)
        assert blas_threads() == {1}
    thread.join()
    assert blas_threads() == {2}
