"""What files say of how they came about."""

import re

import pytest

from mocap_calib.errors import MismatchError
from mocap_calib.io.provenance import date_of_making, describe_judgement
from mocap_calib.job.load import KeypointSource
from mocap_calib.job.steps import CalibrationRequest, read_job


def test_the_date_is_that_of_the_clock_or_of_a_reproducible_build(monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert re.fullmatch(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\dZ", date_of_making())
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert date_of_making() == "1970-01-02T00:00:00Z"


@pytest.mark.parametrize("said", ["today", "1e9", "9" * 30])
def test_a_date_that_is_none_is_refused_in_a_line(said, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", said)
    with pytest.raises(MismatchError, match="SOURCE_DATE_EPOCH: expected whole seconds"):
        date_of_making()


def test_cameras_that_nobody_judged_have_no_comment():
    assert describe_judgement({"command": "mocap-calib average"}) == []


def test_a_bad_date_is_said_before_anything_is_read(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "today")
    nothing = str(tmp_path / "nothing")
    request = CalibrationRequest(KeypointSource((nothing,)), tmp_path / "no.toml", tmp_path / "out")
    with pytest.raises(MismatchError, match="SOURCE_DATE_EPOCH"):
        read_job(request)
