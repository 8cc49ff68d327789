"""Runs without intrinsics, or with rough ones."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from mocap_calib.errors import MismatchError
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib_cli.commands.run import command as run
from mocap_calib_cli.inputs import intrinsics_config
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.texts import parse_image_sizes


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ({"cameras": "i.toml"}, ("none", 0.5, False)),
        ({}, ("focal+k1", 0.5, False)),
        ({"refine": "focal", "focal_per_camera": True}, ("focal", 0.5, True)),
        (
            {"cameras": "i.toml", "refine": "focal+k1", "focal_uncertainty": 0.05},
            ("focal+k1", 0.05, False),
        ),
    ],
)
def test_what_is_estimated(typed, expected):
    found = intrinsics_config(SharedOptions(**typed))
    assert (found.refine, found.focal_uncertainty, found.focal_per_camera) == expected


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (["--refine", "none"], "give --cameras"),
        (["--cameras", "i.toml", "--focal-uncertainty", "5%"], "say --refine focal"),
        (["--cameras", "i.toml", "--focal-per-camera"], "say --refine focal"),
        (["--focal-uncertainty", "0"], "expected a share of up to 100%"),
        (["--focal-uncertainty", "5"], "expected a share of up to 100%"),
        (["--focal-uncertainty", "wide"], "expected a share of up to 100%"),
        (["--image-size", "cam1:640"], "expected a width and a height above 0"),
        (["--refine", "lens"], "--refine"),
    ],
)
def test_options_that_do_not_go_together_are_wrong_usage(typed, said, tmp_path):
    done = CliRunner().invoke(run, ["keypoints", "-o", str(tmp_path / "out"), *typed])
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())
    assert not (tmp_path / "out").exists()


def test_image_sizes_are_of_all_cameras_or_of_one():
    assert parse_image_sizes(()) == ((0, 0), {})
    assert parse_image_sizes(("640x480",)) == ((640, 480), {})
    said = ("cam1:640x480", "1280X720", "a:b:8x6", "cam1:320x240")
    assert parse_image_sizes(said) == ((1280, 720), {"cam1": (320, 240), "a:b": (8, 6)})


def write_points(folder: Path, camera: str) -> None:
    rows = ["frame,keypoint,x,y,score", *(f"0,k{k},{10 * k},5,1" for k in range(4))]
    (folder / f"{camera}.csv").write_text("\n".join(rows))


def test_the_size_of_one_camera_is_that_of_its_files_alone(tmp_path):
    for camera in ("a", "b"):
        write_points(tmp_path, camera)
    options = ReadOptions(image_size=(64, 48), image_sizes={"b": (32, 24)})
    views = {view.camera: view for view in read_keypoints([tmp_path], None, options)}
    assert (views["a"].image_size, views["b"].image_size) == ((64, 48), (32, 24))
    with pytest.raises(MismatchError, match="image sizes of the cameras a, b, found one of c"):
        read_keypoints([tmp_path], None, ReadOptions(image_sizes={"c": (1, 1)}))


def test_a_run_without_sizes_says_what_to_do(tool, tmp_path):
    (tmp_path / "keypoints").mkdir()
    for camera in ("a", "b"):
        write_points(tmp_path / "keypoints", camera)
    done = tool("run", tmp_path / "keypoints", "-o", tmp_path / "out", "--quiet")
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert "--image-size a:WIDTHxHEIGHT" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_run_without_intrinsics_writes_what_it_estimated(tool, small, tmp_path):
    """Focal lengths of the scene are 0.79 to 0.91 image widths, here shared."""
    out = tmp_path / "out"
    done = tool("run", small / "keypoints", "-o", out)
    assert done.returncode == 0, done.stderr
    assert "no intrinsics were given" in done.stderr
    assert "rotations are uncertain by" in done.stderr
    report = json.loads((out / "run.json").read_text())
    assert report["config"]["intrinsics"]["refine"] == "focal+k1"
    for written, camera in zip(
        yaml.safe_load((out / "cameras.yaml").read_text())["cameras"],
        report["cameras"],
        strict=True,
    ):
        found = camera["intrinsics"]
        assert found["source"] == "estimated"
        assert 0.75 < found["focal_px"] / 1280 < 0.95
        assert written["estimated"]["focal_sigma"] == found["focal_sigma_px"]
        np.testing.assert_allclose(np.array(written["K"])[:2, 2], [639.5, 359.5])
