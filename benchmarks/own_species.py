"""Measure the loop that needs no model to begin with.

One animal -> rig by geometry alone -> a model of its species -> two animals, identities unknown.

    .venv/bin/python benchmarks/own_species.py OUT [--steps 2000]

One mouse (DANNCE demo, clip 0; 400 moments at random places, random cameras, 3 px noise) is
calibrated with `--model none`; its 3D poses train a model; with it the recording of two mice is
calibrated, and judged. No shipped weights take part.
"""

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from protocol_scenes import Kind, Subjects, scene

from mocap_calib.io.cameras.own import format_calibration_toml
from mocap_calib.io.keypoints.coco_writer import format_coco
from mocap_calib.types import Keypoints2D

TOOL = [str(Path(sys.executable).with_name("mocap-calib"))]
ANY_VERDICT = ("--accept", "not-determined")


def main() -> None:
    """Run the four commands, and print what they reach."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--shared", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=2000)
    options = parser.parse_args()
    out, two = options.out, options.shared / "recordings" / "dannce_two_mice_projected"
    one_mouse(options.shared / "poses3d", out / "one")
    run(
        "run",
        out / "one/keypoints",
        "--cameras",
        out / "one/intrinsics.toml",
        "--model",
        "none",
        "-o",
        out / "alone",
        *ANY_VERDICT,
    )
    report("one mouse, geometry alone", out / "alone", out / "one/reference.toml")
    run(
        "train",
        "--from",
        out / "alone/poses3d.h5",
        "--steps",
        options.steps,
        "--batch",
        128,
        "-o",
        out / "mouse.safetensors",
    )
    for name, model in (
        ("two mice, geometry alone", "none"),
        ("two mice, own model", out / "mouse.safetensors"),
    ):
        try:
            run(
                "run",
                two / "keypoints",
                "--cameras",
                two / "intrinsics.toml",
                "--model",
                model,
                "-o",
                out / "two",
                *ANY_VERDICT,
            )
            report(name, out / "two", two / "reference.toml")
        except subprocess.CalledProcessError as error:
            print(f"{name}: refused: {error.stderr.strip().splitlines()[-1]}")


def one_mouse(poses: Path, out: Path) -> None:
    """Six cameras, one mouse; the files are those a detector would write."""
    subjects = Subjects(poses, Kind("train_mouse22", "rodent", "+z", "first clip"))
    recording, truth = scene(
        subjects,
        np.random.default_rng(0),
        count=1,
        frames=400,
        views=6,
        noise_px=3.0,
        joints=subjects.joints,
    )
    (out / "keypoints").mkdir(parents=True, exist_ok=True)
    for camera, positions, confidence in zip(
        recording.cameras, recording.positions, recording.confidence, strict=True
    ):
        view = Keypoints2D(
            camera=camera.name,
            keypoints=tuple(subjects.own_names),
            frames=recording.frames,
            positions=positions,
            confidence=confidence,
            tracked=False,
            image_size=camera.size,
            source="simulated",
        )
        (out / "keypoints" / f"{camera.name}.json").write_text(format_coco(view))
    (out / "reference.toml").write_text(format_calibration_toml(truth.rig, {}))
    nowhere = replace(
        truth.rig, rotation=np.tile(np.eye(3), (6, 1, 1)), translation=np.zeros((6, 3))
    )
    (out / "intrinsics.toml").write_text(format_calibration_toml(nowhere, {}))


def run(*words: object) -> str:
    """Run a command of the program; return its stdout."""
    return subprocess.run(
        [*TOOL, *map(str, words)], check=True, capture_output=True, text=True
    ).stdout


def report(name: str, found: Path, reference: Path) -> None:
    """How far the rig is from the reference."""
    errors = json.loads(run("evaluate", found / "cameras.yaml", "--reference", reference, "--json"))
    r, t = errors["rotation_error_deg"], errors["translation_error_deg"]
    individuals = len(json.loads((found / "run.json").read_text())["individuals"])
    print(
        f"{name}: E_R {r['median']:.2f} / {r['max']:.2f} deg, E_t {t['median']:.2f} deg, "
        f"{individuals} individuals",
        flush=True,
    )


if __name__ == "__main__":
    main()
