"""Refuse a torch that brings CUDA, gigabytes that nothing here needs, before it is downloaded.

Called by make in its environment before it installs. Whoever wants CUDA, or has the CPU build from
elsewhere, installs torch first: what is there is left alone.

Requirements are read by the copy of `packaging` that pip brings, as the environment has nothing but
pip yet. Where a pip has no such copy (some systems take it out), nothing is checked.
"""

import importlib.util
import json
import subprocess
import sys
from typing import Any

try:
    from pip._vendor.packaging.requirements import Requirement
except ImportError:
    Requirement = None

PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
ASK = ("install", "--dry-run", "--no-deps", "--report", "-", "-c", "constraints.txt", "torch")


def find_cuda_packages(report: dict[str, Any]) -> list[str]:
    """Return the packages of CUDA that are required, on this system, by what pip would install.

    report: as `pip install --report` writes it.
    """
    metadata = (entry["metadata"] for entry in report["install"])
    required = (Requirement(text) for each in metadata for text in each.get("requires_dist", ()))
    return [
        each.name
        for each in required
        if each.name.startswith(("cuda-", "nvidia-"))
        and (each.marker is None or each.marker.evaluate({"extra": ""}))
    ]


def main() -> None:
    """End with a line on stderr where pip would install CUDA."""
    if Requirement is None or importlib.util.find_spec("torch"):
        return
    done = subprocess.run([*PIP, *ASK], stdout=subprocess.PIPE, check=False)
    if done.returncode:
        sys.exit(done.returncode)  # pip has said why
    report = json.loads(done.stdout)
    packages = find_cuda_packages(report)
    if packages:
        version = report["install"][0]["metadata"]["version"]
        sys.exit(
            f"expected the CPU build of torch, found {version} with CUDA (5 GB: "
            f"{', '.join(packages)}); install torch into .venv first, as README.md says under "
            "Installation, and call make again"
        )


if __name__ == "__main__":
    main()
