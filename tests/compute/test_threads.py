"""Two calls at the same time: each may spread its work, and errors come back in order."""

import threading

import pytest

from mocap_calib.compute import parallel
from mocap_calib.compute.parallel import do_both, map_in_threads


def fail(message):
    raise ValueError(message)


@pytest.mark.usefixtures("two_processors")
def test_both_calls_are_under_way_at_the_same_time_and_spread_their_work():
    met = threading.Barrier(2, timeout=120)  # broken where one call waits for the other to end

    def meet_and_spread(numbers):
        met.wait()
        return list(map_in_threads(lambda number: number * number, numbers))

    found = do_both(lambda: meet_and_spread([1, 2, 3]), lambda: meet_and_spread([4, 5]))
    assert found == ([1, 4, 9], [16, 25])


@pytest.mark.usefixtures("two_processors")
def test_what_the_first_raises_comes_before_what_the_second_raises():
    for second in (lambda: 1, lambda: fail("second")):
        with pytest.raises(ValueError, match="first"):
            do_both(lambda: fail("first"), second)
    with pytest.raises(ValueError, match="second"):
        do_both(lambda: 1, lambda: fail("second"))


@pytest.mark.usefixtures("two_processors")
def test_a_thread_that_was_given_work_makes_both_calls_itself():
    def of_one(_):
        return do_both(threading.get_ident, threading.get_ident)

    assert all(first == second for first, second in map_in_threads(of_one, range(4)))


def test_one_processor_makes_one_call_after_the_other(monkeypatch):
    monkeypatch.setattr(parallel, "thread_count", lambda: 1)
    here = threading.get_ident()
    assert do_both(threading.get_ident, threading.get_ident) == (here, here)


@pytest.mark.usefixtures("two_processors")
def test_two_calls_within_two_calls_are_made_one_after_the_other():
    """No more threads than two wait for others, however deep; afterwards there are two again."""

    def within():
        here = threading.get_ident()
        return do_both(threading.get_ident, threading.get_ident) == (here, here)

    for _ in range(2):
        assert do_both(within, within) == (True, True)


@pytest.mark.usefixtures("two_processors")
def test_an_interruption_does_not_wait_for_the_other_call():
    ended = threading.Event()

    def interrupt():
        raise KeyboardInterrupt

    try:
        with pytest.raises(KeyboardInterrupt):
            do_both(interrupt, lambda: ended.wait(20))
        assert not ended.is_set()
        assert do_both(lambda: 1, lambda: 2) == (1, 2)
    finally:
        ended.set()
