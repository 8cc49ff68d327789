"""`make demo` says what it should: the first thing a newcomer sees."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.skipif(
    not (ROOT / ".venv" / "installed").exists() or not shutil.which("make"),
    reason="not the environment that make makes",
)
def test_demo():
    said = subprocess.run(["make", "demo"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    median, largest = (
        float(re.search(rf"^{name} +(\S+)", said.stdout, re.M).group(1))
        for name in ("median", "max")
    )
    assert median < 0.1  # measured 0.02 degrees
    assert largest < 0.2  # 0.04
    assert "3 individuals in 200 of 200 frames" in said.stderr
    assert "the results are in out/demo" in said.stdout
    listed = said.stdout.split("the results are in out/demo")[1]
    for name in (
        "cameras.yaml",
        "calibration.toml",
        "poses3d.h5",
        "poses3d_0.csv",
        "matches.csv",
        "run.json",
        "report.html",
    ):
        assert name in listed


def test_the_example_is_small():
    assert sum(p.stat().st_size for p in (ROOT / "examples").rglob("*") if p.is_file()) < 2e6
