"""benchmarks/certainty.py: its cases are what they say, and it judges them by the truth alone."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scenes import scene

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module


def moved(rig, *, turn, shift, scale):
    """The same rig in other coordinates of the world: x' = scale turn x + shift."""
    rotation = rig.rotation @ turn.T
    centres = scale * rig.centres @ turn.T + shift
    return rig.stand(rotation, centres)


def test_errors_know_no_similarity_and_are_turns_and_shifts(benchmark):
    errors = benchmark("certainty")
    rig = scene(cameras=4, people=1).rig
    turn = matrix_from_vector(np.array([0.4, -1.0, 2.0]))
    same = moved(rig, turn=turn, shift=np.array([3.0, 1.0, -2.0]), scale=1.7)
    assert np.abs(errors.rig_error(same, rig)).max() < 1e-9
    wrong = same.rotation.copy()
    wrong[2] = matrix_from_vector(np.array([0.0, np.radians(2.0), 0.0])) @ wrong[2]
    found = np.degrees(np.linalg.norm(errors.rig_error(replace(same, rotation=wrong), rig), axis=1))
    # the best similarity takes a share of it: one camera of four, 2 deg before
    assert 1.0 < found[2] < 2.0
    assert found[2] > 2 * np.delete(found, 2).max()
    assert errors.worst_pair_deg(replace(same, rotation=wrong), rig) == pytest.approx(2.0)


def test_distances_of_draws_from_a_covariance_are_those_of_three_degrees_of_freedom(benchmark):
    errors = benchmark("certainty")
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(3, 3))
    covariance = np.zeros((500, 3, 500, 3))
    covariance[np.arange(500), :, np.arange(500), :] = factor @ factor.T
    distance = errors.mahalanobis(rng.normal(size=(500, 3)) @ factor.T, covariance)
    assert 2.6 < np.mean(distance) < 3.4  # 3, and a standard error of 0.11


def test_cases_are_always_the_same_and_of_all_kinds(benchmark):
    cases = benchmark("certainty_cases")
    made, again = (list(cases.degenerate_cases(2)) for _ in range(2))
    assert [case.kind for case in made] == 2 * list(cases.KINDS)
    assert len({case.name for case in made}) == len(made)
    by_name, same = ({case.name: case for case in cases} for cases in (made, again))
    few = by_name["1_to_3_frames-1"].make()
    assert few.views == same["1_to_3_frames-1"].make().views
    assert len(few.record().frames) == 2
    copied = by_name["duplicate-0"].make()
    with pytest.raises(MismatchError, match="cam1 and cam2 have the same detections"):
        copied.record()
    first, second = copied.truth[0].centres[:2]
    assert (first == second).all()
    still = by_name["static-1"].make().views[0].positions
    assert np.nanmax(np.abs(np.diff(still, axis=0))) < 1.0  # 0.1 px of noise: 7 sigma of it
    ahead = by_name["facing_pair-0"].make().truth[0].rotation[:, 2, :2]
    assert np.dot(*ahead) < -0.7 * np.linalg.norm(ahead[0])
    assert len(by_name["unrelated-0"].make().truth) == 2


def line(kind, *groups, refused=""):
    found = [
        {"verdict": verdict, "pair_deg": error, "true": error is not None}
        for verdict, error in groups
    ]
    return {"kind": kind, "refused": refused, "groups": found}


@pytest.mark.parametrize(
    ("case", "right"),
    [
        (line("static", ("well determined", 2.9)), True),
        (line("static", ("well determined", 3.1)), False),
        (line("static", ("usable", 8.0)), True),
        (line("static", ("usable", 12.0)), False),
        (line("noise only", ("not determined", 170.0)), True),
        (line("noise only", ("weak", 170.0)), False),
        (line("unrelated", ("weak", None)), False),
        (line("unrelated", ("well determined", 0.1), ("usable", 20.0)), False),
        (line("duplicate", refused="the same detections"), True),
        (line("sound", refused="nothing"), False),
        (line("sound", ("not determined", 0.2)), False),
        (line("sound", ("not determined", 4.0)), True),
        (line("sound", ("weak", 0.2)), True),
    ],
)
def test_a_verdict_is_right_where_it_promises_no_more_than_is_so(benchmark, case, right):
    assert benchmark("certainty").is_right(case) == right
