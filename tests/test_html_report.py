"""report.html: what is in it, that it is small, and that nothing in it comes from outside."""

import base64
import hashlib
import html
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from report_pages import page_data, report_source, unpack, unpack_text
from report_sizes import large_source
from scenes import turn_cameras

from mocap_calib.errors import MismatchError
from mocap_calib.html_report.encode import MISSING, pack, pack_floats, pack_text, to_script
from mocap_calib.html_report.frames import choose_frames, quantiles, starts_of_stretches
from mocap_calib.html_report.page import report_page
from mocap_calib.html_report.source import Reference
from mocap_calib.types import CameraRig
from mocap_calib.verdict.checks import CHECKS, find_residuals

ROOT = Path(__file__).parents[1]
LIMIT = 3_000_000  # bytes


@cache
def source(**scene):
    return report_source(**({"cameras": 3, "people": 2, "frames": 30} | scene))


@cache
def data():
    return page_data(report_page(source()))


# --- packing


@given(
    st.sampled_from(["i2", "i4", "u1", "u2"]).flatmap(
        lambda kind: arrays.arrays(kind, arrays.array_shapes(max_dims=3, min_side=0))
    ),
    st.booleans(),
)
def test_integers_come_back_as_they_were(values, differences):
    packed = pack(values, delta=values.ndim - 1 if differences else None)
    assert np.array_equal(unpack(packed), values)


def test_floats_keep_four_digits():
    values = np.array([1.0, -1234.5678, 1e-7, np.nan, 3e20, 0.0])
    found = unpack(pack_floats(values))
    assert np.allclose(found, values, rtol=1.3e-4, equal_nan=True)
    assert found[0] == 1.0


def test_text_comes_back_and_cannot_end_its_element():
    text = 'é </script><script>alert(1)</script> <!-- &amp; \u2028 "\\'
    assert unpack_text(pack_text(text)) == text
    written = to_script({text: text})
    assert json.loads(written) == {text: text}
    assert not re.search(r"[<>&\u2028]", written)


@pytest.mark.parametrize(("total", "count"), [(10, 10), (100, 7), (100_000, 900), (5, 0), (61, 60)])
def test_frames_are_stretches_over_the_whole_recording(total, count):
    chosen = choose_frames(total, count)
    assert len(chosen) <= count
    assert len(chosen) > 0.7 * count - 1
    starts = starts_of_stretches(chosen)
    if count:
        assert starts[0] == 0
        assert chosen[0] == 0
        assert chosen[-1] == total - 1
    if total == 100_000:
        assert len(starts) == 15


def test_quantiles_are_those_of_numpy():
    values = np.random.default_rng(0).normal(size=(3, 40))
    values[0, 5:] = values[1] = np.nan
    found = quantiles(values, (0.5, 0.95))
    known = [0, 2]
    assert np.allclose(found[:, known], np.nanquantile(values[known], (0.5, 0.95), axis=1))
    assert np.isnan(found[:, 1]).all()


# --- what a page holds


def test_the_numbers_are_those_of_run_json():
    run = json.loads(json.dumps(source().run))
    of_one_run = ("date", "seconds", "inputs")
    shown = {key: value for key, value in run.items() if key not in of_one_run}
    assert json.loads(unpack_text(data()["run"])) == shown


def test_bodies_are_where_they_are():
    poses, found = source().poses, data()["poses"]
    steps = unpack(found["points"])
    points = np.where(steps == MISSING, np.nan, steps * found["scale"]) + found["offset"]
    expected = np.moveaxis(poses.positions, 1, 0)
    assert np.array_equal(np.isnan(points), np.isnan(expected))
    assert np.nanmax(np.abs(points - expected)) <= 0.51 * found["scale"]
    body = np.nanmedian(np.ptp(expected, axis=2))
    assert found["scale"] < 0.003 * body
    assert np.array_equal(unpack(found["frames"]), poses.frames)
    assert np.array_equal(unpack(found["source"]), np.moveaxis(poses.source, 1, 0))


def test_detections_are_where_they_were_seen():
    recording, labels = source().seen.recording, source().seen.matches.labels
    shown = unpack(data()["poses"]["frames"])[unpack(data()["detections"]["frames"])]
    assert np.array_equal(shown, recording.frames)
    for view, found in enumerate(data()["detections"]["cameras"]):
        frame, individual = unpack(found["frame"]), unpack(found["individual"])
        steps = unpack(found["points"])
        points = np.where(steps == MISSING, np.nan, steps * found["scale"])
        assert len(frame) == recording.seen[view].any(-1).sum()
        for row in range(0, len(frame), 7):
            own = np.flatnonzero(labels[view, frame[row]] == individual[row])
            near = [
                np.nanmax(np.abs(recording.positions[view, frame[row], k] - points[row]))
                for k in own
                if recording.seen[view, frame[row], k].any()
            ]
            assert min(near) <= 0.51 * found["scale"]


def test_errors_are_those_of_the_points():
    given = source()
    frames = np.arange(len(given.poses.frames))
    left = find_residuals(
        given.seen.recording, given.seen.matches, given.rig, given.poses.raw, frames
    )
    fits = data()["fits"]
    joints = unpack(fits["by_joint"])
    views = len(given.rig)
    by_joint = np.moveaxis(left.distance, -1, 1).reshape(views, joints.shape[1], -1)
    assert np.allclose(joints, np.nanmedian(by_joint, axis=-1), rtol=1e-3, equal_nan=True)
    counts, residuals = unpack(fits["counts"]), unpack(fits["residuals"])
    assert np.array_equal(counts.sum((1, 2)), np.isfinite(left.distance).sum((1, 2, 3)))
    mean = (counts[..., None] * residuals * fits["residual_scale"]).sum((1, 2)) / counts.sum(
        (1, 2)
    )[:, None]
    assert np.allclose(mean, np.nanmean(left.gap.reshape(views, 2, -1), axis=-1), atol=0.01)


def test_runs_say_when_a_camera_shows_an_individual():
    labels, frames = source().seen.matches.labels, source().seen.recording.frames
    there = np.zeros((len(labels), labels.max() + 1, len(frames)), dtype=bool)
    runs = unpack(data()["timeline"]["runs"])
    for view, individual, first, last in runs:
        assert not there[view, individual, frames == first].any()
        there[view, individual, (frames >= first) & (frames <= last)] = True
    for individual in range(there.shape[1]):
        assert np.array_equal(there[:, individual], (labels == individual).any(-1))


def test_exchanged_names_of_a_file_are_swaps():
    given = source()
    frames = len(given.seen.recording.frames)
    tracked = given.seen.matches.labels.copy()
    tracked[0, :, :2] = [0, 1]
    tracked[0, frames // 2 :, :2] = [1, 0]
    recording = replace(given.seen.recording, tracked=np.array([True, False, False]))
    seen = replace(
        given.seen, recording=recording, matches=replace(given.seen.matches, labels=tracked)
    )
    found = page_data(report_page(replace(given, seen=seen)))["timeline"]
    middle = recording.frames[frames // 2]
    assert unpack(found["swaps"]).tolist() == [[0, middle, 0, 1], [0, middle, 1, 0]]
    assert found["swaps_total"] == 2


def test_series_are_of_all_bodies():
    series, poses = data()["series"], source().poses
    bones, speed = unpack(series["bones"]), unpack(series["speed"])
    a, b = source().edges[0]
    length = np.nanmedian(
        np.linalg.norm(poses.positions[:, 0, a] - poses.positions[:, 0, b], axis=-1)
    )
    assert np.nanmedian(bones[0, 0]) == pytest.approx(length, rel=0.01)
    assert bones.shape == (2, len(source().edges), len(series["bins"]))
    assert np.isfinite(speed).mean() > 0.9
    per_frame = unpack(page_data(report_page(replace(source(), fps=np.nan)))["series"]["speed"])
    assert np.allclose(speed, 30 * per_frame, rtol=1e-3, equal_nan=True)


def test_a_rig_laid_over_itself_fits_and_a_turned_camera_is_told():
    given = source()
    same = given.rig.scale(1000.0, "mm") if given.rig.unit == "m" else given.rig.scale(7.0, "mm")
    found = page_data(report_page(replace(given, reference=Reference("a/ref.toml", same))))
    assert found["reference"]["title"] == "ref.toml"
    assert max(each["rotation_deg"] for each in found["reference"]["errors"]) < 1e-5
    assert max(each["centre_percent"] for each in found["reference"]["errors"]) < 1e-6
    other = turn_cameras(given.rig, 5.0)
    found = page_data(report_page(replace(given, reference=Reference("r", other))))
    assert 2 < max(each["rotation_deg"] for each in found["reference"]["errors"]) < 7
    strangers = CameraRig(
        tuple(replace(camera, name=f"x{camera.name}") for camera in given.rig.cameras),
        given.rig.rotation,
        given.rig.translation,
    )
    with pytest.raises(MismatchError, match="at least two cameras of cam1, cam2, cam3"):
        report_page(replace(given, reference=Reference("r", strangers)))


def test_without_keypoints_the_page_says_so():
    found = page_data(report_page(replace(source(), seen=None)))
    assert found["detections"] is found["fits"] is found["timeline"] is None
    assert any("no keypoints were read" in note for note in found["notes"])


def test_what_checks_mean_is_on_the_page():
    told = page_data(report_page(source()))["checks"]
    assert {name: about["text"] for name, about in told.items()} == {
        kind.name: kind.text for kind in CHECKS
    }
    assert {check["name"] for check in source().run["verdict"]["checks"]} <= set(told)


# --- safe, small, the same again


def test_names_are_never_html():
    bad = '</script><script>alert("x")</script><img src=x onerror=alert(1)>'
    given = source()
    cameras = tuple(replace(each, name=f"{k}{bad}") for k, each in enumerate(given.rig.cameras))
    joints = tuple(f"{k}{bad}" for k in range(len(given.poses.keypoints)))
    named = replace(
        given,
        title=bad,
        rig=replace(given.rig, cameras=cameras),
        poses=replace(given.poses, keypoints=joints),
        run={**given.run, "keypoints": list(joints), "model": bad},
        notes=(bad,),
    )
    page, plain = report_page(named), report_page(given)
    for mark in ("<script", "</script", "<img", "onerror", "alert("):
        in_data = page.split('id="report-data">')[1].split("</script>")[0]
        assert mark not in in_data or not mark.startswith("<")
        if mark.startswith("<"):
            assert page.count(mark) == plain.count(mark)
    assert f"<title>{html.escape(bad)}: mocap-calib</title>" in page
    assert page_data(page)["skeleton"]["joints"] == list(joints)


def test_only_what_is_in_the_page_may_run():
    page = report_page(source())
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)[1]
    assert policy.startswith("default-src 'none';")
    for kind, text in (
        ("script", re.findall(r"<script>(.*?)</script>", page, re.S)),
        ("style", re.findall(r"<style>(.*?)</style>", page, re.S)),
    ):
        (content,) = text
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}';" in policy
    assert "unsafe" not in policy
    assert "http" not in policy


def test_the_same_again():
    assert report_page(source()) == report_page(source())


@pytest.mark.parametrize(
    "size",
    [
        {"cameras": 31, "people": 20, "frames": 5000},
        {"cameras": 2, "people": 1, "frames": 100_000},
        {"cameras": 90, "people": 3, "frames": 50},
        {"cameras": 2, "people": 300, "frames": 300},
    ],
    ids=str,
)
def test_pages_of_any_recording_are_small_and_full(size):
    page = report_page(large_source(source(), **size))
    found = page_data(page)
    assert len(page.encode()) < LIMIT
    assert found["poses"]["total"] == size["frames"]
    frames = unpack(found["poses"]["frames"])
    assert len(frames) == size["frames"] or len(page.encode()) > LIMIT / 2
    assert len(frames) >= 20
    assert frames[-1] == size["frames"] - 1
    assert len(unpack(found["detections"]["frames"])) >= 2


def test_the_page_holds_what_the_same_input_gives_again():
    """Dates, times and hashes are in run.json alone."""
    of_one_run = {"date": "2026-01-31", "seconds": {"lift": 1.0}, "inputs": {"a": "b"}}
    of_one_run |= {"outputs": {"report.html": "c"}, "fingerprint": "d"}
    again = replace(source(), run={**source().run, **of_one_run})
    assert report_page(again) == report_page(source())


def test_nobody_was_found():
    given = source()
    empty = replace(given, poses=given.poses.select([]), seen=None)
    found = page_data(report_page(empty))
    assert found["poses"]["individuals"] == []
