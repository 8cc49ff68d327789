"""`scale`: known lengths set the scale of results that lie in a folder."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from mocap_calib.errors import FormatError
from mocap_calib.io.cameras.read import load_cameras, read_rig
from mocap_calib.io.cameras.write import format_rig
from mocap_calib.io.hashing import hash_file
from mocap_calib.io.poses.read import load_poses
from mocap_calib.job.scaling import _read_report


@pytest.mark.slow
def test_scale_rewrites_cameras_poses_and_the_report_together(done, tool, tmp_path):
    out = shutil.copytree(done[0], tmp_path / "out")
    before, poses = read_rig(out / "cameras.yaml"), load_poses(out / "poses3d.h5").poses
    assert before.unit == poses.unit == "arbitrary"
    a, b = before.names[:2]
    length = np.linalg.norm(before.centres[1] - before.centres[0])
    said = tool("scale", out, "--camera-distance", f"{a}-{b}=3.1")
    assert said.returncode == 0, said.stderr
    assert "lengths are in m" in said.stderr
    factor = 3.1 / length
    for name in ("cameras.yaml", "calibration.toml"):
        rig = read_rig(out / name)
        np.testing.assert_allclose(rig.centres, factor * before.centres, atol=1e-9)
        assert (rig.unit, rig.world.kind) == ("m", before.world.kind)
        verdicts = [load_cameras(folder / name).judgement["verdict"] for folder in (out, done[0])]
        assert verdicts[0] == verdicts[1]
    after = load_poses(out / "poses3d.h5").poses
    np.testing.assert_allclose(after.positions, factor * poses.positions)
    np.testing.assert_allclose(
        load_poses(out / "poses3d_0.csv").poses.positions[:, 0],
        factor * load_poses(done[0] / "poses3d_0.csv").poses.positions[:, 0],
    )
    report = json.loads((out / "run.json").read_text("utf-8"))
    assert (report["unit"], report["world"]["unit"], report["fingerprint"]) == ("m", "m", None)
    size = np.sqrt(((rig.centres - rig.centres.mean(0)) ** 2).sum(1).mean())
    for each in (*report["cameras"], *report["pairs"]):
        expected = each["centre_sigma_percent"] / 100 * size
        assert each["centre_sigma"] == pytest.approx(expected, rel=1e-6)
    (cue,) = report["world"]["cues"]
    assert cue["metres"] == pytest.approx(3.1)
    assert all(hash_file(out / name) == kept for name, kept in report["outputs"].items())
    metric = tool("convert", out / "cameras.yaml", tmp_path / "a.toml", "--to", "anipose",
                  "--unit", "mm")  # fmt: skip
    assert metric.returncode == 0, metric.stderr
    np.testing.assert_allclose(
        read_rig(tmp_path / "a.toml").centres, 1000 * factor * before.centres, atol=1e-6
    )


@pytest.mark.slow
def test_scaled_results_are_scaled_again_and_known_units_are_left_alone(done, tool, tmp_path):
    out = shutil.copytree(done[0], tmp_path / "out")
    names = "-".join(read_rig(out / "cameras.yaml").names[:2])
    for length in (3.1, 3.0):
        said = tool("scale", out, "--camera-distance", f"{names}={length}")
        assert said.returncode == 0, said.stderr
    rig = read_rig(out / "cameras.yaml")
    assert np.linalg.norm(rig.centres[1] - rig.centres[0]) == pytest.approx(3.0)
    assert [cue.metres for cue in rig.world.cues] == [3.0]
    given = replace(rig, world=replace(rig.world, kind="file", cues=()))
    (content,) = format_rig(given, "mocap-calib", {}).files.values()
    (out / "cameras.yaml").write_bytes(content)
    (out / "run.json").write_text("edited", "utf-8")
    before = {file.name: hash_file(file) for file in out.iterdir() if file.is_file()}
    said = tool("scale", out, "--height", "1.75")
    assert (said.returncode, said.stderr.count("\n")) == (1, 1)
    assert "found them in m by cameras whose places were given" in said.stderr
    (content,) = format_rig(rig, "mocap-calib", {}).files.values()
    (out / "cameras.yaml").write_bytes(content)
    damaged = tool("scale", out, "--camera-distance", f"{names}=2")
    assert (damaged.returncode, damaged.stderr.count("\n")) == (1, 1)
    assert "run.json: expected what a run writes" in damaged.stderr
    after = {file.name: hash_file(file) for file in out.iterdir() if file.is_file()}
    assert {name for name in before if after[name] != before[name]} == {"cameras.yaml"}  # ours


@pytest.mark.slow
def test_nobody_stands_where_the_rig_is_not_determined(done, tool, tmp_path):
    out = shutil.copytree(done[0], tmp_path / "out")
    rig = read_rig(out / "cameras.yaml")
    doubted = {**load_cameras(out / "cameras.yaml").judgement, "verdict": "not determined"}
    (content,) = format_rig(rig, "mocap-calib", doubted).files.values()
    (out / "cameras.yaml").write_bytes(content)
    said = tool("scale", out, "--height", "1.75")
    assert said.returncode == 1
    assert "found that the rig is not determined" in said.stderr


@pytest.mark.parametrize("edited", [{"pairs": ["a pair"]}, {"pairs": [{"centre_sigma": "small"}]}])
def test_an_edited_report_is_refused_in_a_line(edited, tmp_path):
    path = tmp_path / "run.json"
    path.write_text(json.dumps({"cameras": [], **edited}), "utf-8")
    with pytest.raises(FormatError, match="expected what a run writes"):
        _read_report(path)


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        ((), 2, "expected a known length"),
        (("--height", "tall"), 2, "--height"),
        (("--length", "0.42"), 2, "two joints and metres"),
        (("--height", "1.75"), 1, "expected the results of a run"),
    ],
)
def test_what_was_typed_wrong_is_said_in_a_line(arguments, status, says, tool, tmp_path):
    said = tool("scale", tmp_path, *arguments)
    assert said.returncode == status
    assert says in said.stderr


def test_a_file_of_a_run_is_no_folder_of_one(tool, tmp_path):
    (tmp_path / "poses3d.h5").write_bytes(b"")
    said = tool("scale", tmp_path / "poses3d.h5", "--height", "1.75")
    assert (said.returncode, said.stderr.count("\n")) == (1, 1)
    assert "poses3d.h5: expected the folder of a run, found a file; give the folder" in said.stderr


@pytest.mark.slow
def test_arbitrary_lengths_are_converted_to_no_unit(done, tool, tmp_path):
    for option in ("--unit", "--input-unit"):
        said = tool("convert", done[0] / "poses3d.h5", tmp_path / "a.npz", option, "m")
        assert said.returncode == 1
        assert said.stderr.count("\n") == 1
        assert "mocap-calib scale" in said.stderr
