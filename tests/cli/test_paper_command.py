"""The paper's solver and its own network on the command line."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from click.testing import CliRunner
from scenes import rotation_errors_deg

from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.camera_files import read_rig
from mocap_calib.paper import solver
from mocap_calib.training.model import TokenSteerer
from mocap_calib_cli.commands import run, simulate

SCENE = ["--people", "1", "--cameras", "2", "--frames", "8", "--quiet"]


@pytest.mark.slow
def test_a_rotation_token_calibrates_by_the_papers_solver_alone(tmp_path, monkeypatch):
    """From files to files: 20 steps from 6 degrees away, for 1,000 from anywhere.

    Measured 3.2 degrees. The search of pairs cannot take the network, as it does not lift.
    """
    runner, made = CliRunner(), tmp_path / "made"
    runner.invoke(simulate.command, [*SCENE, "-o", str(made)], catch_exceptions=False)
    truth = read_rig(made / "reference.toml")
    near = torch.from_numpy(vector_from_matrix(truth.relative(0, 1)[0])).float() + 0.06
    steered, solve = [], solver.solve_pairs

    def solve_from_near(*arguments: Any) -> Any:
        """Do what the solver does, in less time."""
        views, model, config, generator = arguments
        steered.append(model)
        few = replace(config, iterations=20, tries=1)
        return solve(views, model, few, generator, start=near[None])

    monkeypatch.setattr(solver, "solve_pairs", solve_from_near)
    files = [str(made / "keypoints"), "--cameras", str(made / "intrinsics.toml"), "--no-report"]
    asked = [*files, "--quiet", "--model", "people_token", "-o"]
    done = runner.invoke(run.command, [*asked, str(tmp_path / "out"), "--solver", "paper"])
    assert done.exit_code == 0, done.output
    assert isinstance(steered[0], TokenSteerer)
    found = read_rig(tmp_path / "out/cameras.yaml")
    assert rotation_errors_deg(found, truth).max() < 5
    refused = runner.invoke(run.command, [*asked, str(tmp_path / "no")])
    assert "with solver='paper'" in str(refused.exception)
    assert not (tmp_path / "no").exists()
