"""report.html: what is in it, that it is small, and that nothing in it comes from outside."""

import base64
import hashlib
import html
import json
import re
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from report_pages import (
    MISSING,
    large_source,
    page_data,
    page_of,
    report_source,
    unpack,
    unpack_text,
)
from scenes import gaps, turn_cameras

import mocap_calib as mc

LIMIT = 3_000_000  # bytes


@cache
def source(**scene):
    return report_source(**({"cameras": 3, "people": 2, "frames": 30} | scene))


@cache
def data():
    return page_data(page_of(source()))


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
    given, views = source(), len(source().rig)
    gap = gaps(given.rig, given.seen.recording, given.seen.matches, given.poses.raw)
    fits, distance = data()["fits"], np.linalg.norm(gap, axis=-1)
    joints = unpack(fits["by_joint"])
    by_joint = np.moveaxis(distance, -1, 1).reshape(views, joints.shape[1], -1)
    assert np.allclose(joints, np.nanmedian(by_joint, axis=-1), rtol=1e-3, equal_nan=True)
    counts, residuals = unpack(fits["counts"]), unpack(fits["residuals"])
    assert np.array_equal(counts.sum((1, 2)), np.isfinite(distance).sum((1, 2, 3)))
    sums = (counts[..., None] * residuals * fits["residual_scale"]).sum((1, 2))
    mean = sums / counts.sum((1, 2))[:, None]
    assert np.allclose(mean, np.nanmean(gap.reshape(views, -1, 2), axis=1), atol=0.01)


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
    matches = replace(given.seen.matches, labels=tracked)
    seen = replace(given.seen, recording=recording, matches=matches)
    found = page_data(page_of(given, seen=seen))["timeline"]
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
    per_frame = unpack(page_data(page_of(source(), fps=np.nan))["series"]["speed"])
    assert np.allclose(speed, 30 * per_frame, rtol=1e-3, equal_nan=True)


def test_a_rig_laid_over_itself_fits_and_a_turned_camera_is_told():
    given = source()
    same = given.rig.scale(7.0, "mm")
    found = page_data(page_of(given, same))["reference"]
    assert found["title"] == "ref.toml"
    assert max(each["rotation_deg"] for each in found["errors"]) < 1e-5
    assert max(each["centre_percent"] for each in found["errors"]) < 1e-6
    found = page_data(page_of(given, turn_cameras(given.rig, 5.0)))["reference"]
    assert 2 < max(each["rotation_deg"] for each in found["errors"]) < 7
    cameras = tuple(replace(camera, name=f"x{camera.name}") for camera in given.rig.cameras)
    with pytest.raises(mc.MismatchError, match="cam1, cam2, cam3"):
        page_of(given, replace(given.rig, cameras=cameras))


def test_without_keypoints_the_page_says_so():
    found = page_data(page_of(source(), seen=None))
    assert found["detections"] is found["fits"] is found["timeline"] is None
    assert any("no keypoints were read" in note for note in found["notes"])


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
    page, plain = page_of(named), page_of(given)
    in_data = page.split('id="report-data">')[1].split("</script>")[0]
    for mark in ("<script", "</script", "<img"):
        assert mark not in in_data
        assert page.count(mark) == plain.count(mark)
    assert f"<title>{html.escape(bad)}: mocap-calib</title>" in page
    assert page_data(page)["skeleton"]["joints"] == list(joints)


def test_only_what_is_in_the_page_may_run():
    page = page_of(source())
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)[1]
    assert policy.startswith("default-src 'none';")
    for kind in ("script", "style"):
        (content,) = re.findall(rf"<{kind}>(.*?)</{kind}>", page, re.S)
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}';" in policy
    assert "unsafe" not in policy
    assert "http" not in policy


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
    page = page_of(large_source(source(), **size))
    found = page_data(page)
    assert len(page.encode()) < LIMIT
    assert found["poses"]["total"] == size["frames"]
    frames = unpack(found["poses"]["frames"])
    assert len(frames) == size["frames"] or len(page.encode()) > LIMIT / 2
    assert len(frames) >= 20
    assert frames[-1] == size["frames"] - 1
    assert len(unpack(found["detections"]["frames"])) >= 2


def test_nobody_was_found():
    given = source()
    empty = replace(given, poses=given.poses.select([]), seen=None)
    found = page_data(page_of(empty))
    assert found["poses"]["individuals"] == []


# --- the bundle of web/


WEB = Path(__file__).parents[1] / "web"


@pytest.mark.parametrize("name", ["page.js", "page.css"])
def test_the_bundle_is_made_of_these_sources(name):
    """Otherwise: `make web`, and commit what it makes."""
    paths = [
        f"src/{path.name}" for path in (WEB / "src").iterdir() if path.suffixes != [".d", ".ts"]
    ]
    digest = hashlib.sha256()
    for path in sorted(["package.json", "build.mjs", *paths]):
        digest.update((WEB / path).read_bytes())
    text = (resources.files("mocap_calib.html_report") / name).read_text(encoding="utf-8")
    assert re.findall(r"of sources ([0-9a-f]{64})", text) == [digest.hexdigest()]


def test_the_bundle_has_its_licences_and_is_small():
    text = (resources.files("mocap_calib.html_report") / "page.js").read_text(encoding="utf-8")
    packages = json.loads((WEB / "package.json").read_text())["devDependencies"]
    for name in ("three", "uplot"):
        assert f"{name} {packages[name]}" in text
    assert text.count("THE SOFTWARE IS PROVIDED") == 2
    assert len(text) < 800_000  # 716,000


def test_no_address_of_a_registry_is_in_the_lock_file():
    lock = json.loads((WEB / "package-lock.json").read_text())
    packages = [each for path, each in lock["packages"].items() if path]
    assert packages
    assert all("resolved" not in each and each["integrity"] for each in packages)


def test_markup_is_never_made_of_text():
    """Elements are made by `dom.ts`, whose children are text."""
    for path in (WEB / "src").glob("*.ts"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(", text)
        # style attributes would break the page's policy
        assert not re.search(r"setAttribute\(.style|\bstyle: ", text), path
