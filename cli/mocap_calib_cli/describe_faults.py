"""What is said of files that are wrong, and of what was done about them."""

from pathlib import Path
from typing import Any


def describe_faults(report: dict[str, Any], folder: Path) -> list[str]:
    """Say what is wrong with the files of cameras; folder: of the results."""
    return [
        *_describe_mended(report),
        *_describe_epochs(report, folder),
        *_describe_clocks(report),
        *describe_measured_faults(report),
    ]


def describe_measured_faults(report: dict[str, Any]) -> list[str]:
    """Say what the errors of the adjusted rig show to be wrong with cameras."""
    return [*_describe_outlier_cameras(report), *_describe_wrong_focal(report)]


def _describe_mended(report: dict[str, Any]) -> list[str]:
    """Say what is wrong with the files of cameras, and what was done about it."""
    lines = []
    for camera in report["cameras"]:
        for fault in camera["fault_evidence"].values():
            line = f"{camera['name']}: {fault['says']}"
            if fault["mended"]:
                line += f"; mended for this run: {fault['advice']}"
                line += f", or say {fault['option']}" if fault["option"] else ""
            lines.append(line)
    return lines


def _describe_epochs(report: dict[str, Any], folder: Path) -> list[str]:
    """Say where the rig of each part of the recording is, where a camera was moved."""
    epochs = report["epochs"]
    if len(epochs) == 1:
        return []
    places = [
        f"frames {epoch['first']} to {epoch['last']} in {folder / epoch['folder']}"
        for epoch in epochs
    ]
    return [f"{len(epochs)} rigs, as cameras were moved: {', '.join(places)}"]


def _describe_clocks(report: dict[str, Any]) -> list[str]:
    """Say by what part of a frame clocks are off, where that was used."""
    clocks = {camera["name"]: camera["clock"] for camera in report["cameras"]}
    used = [
        f"{name} {clock['subframe_offset']:+.2f} (+- {clock['sigma']:.2f})"
        for name, clock in clocks.items()
        if clock["used"]
    ]
    if not used:
        return []
    first = report["cameras"][0]["name"]
    return [
        f"clocks, frames late beside {first}: {', '.join(used)}; rig and poses are made with that, "
        f"poses at the clock of {first}"
    ]


def _describe_outlier_cameras(report: dict[str, Any]) -> list[str]:
    """Say which cameras are inconsistent with the others."""
    names = _cameras_with_fault(report, "inconsistent")
    if not names:
        return []
    return [
        f"inconsistent: {', '.join(names)}: errors several times those of the other cameras; "
        "out of step (shift it with --frame-offset), moved, or with other intrinsics"
    ]


def _describe_wrong_focal(report: dict[str, Any]) -> list[str]:
    """Say which focal lengths would change, by how much, and how sure that is.

    Of those that were mended the fault itself says it.
    """
    changes = {
        each["name"]: each["intrinsics"]
        for each in report["cameras"]
        if "focal" in each["faults"] and "focal" not in each["fault_evidence"]
    }
    return [
        f"focal: {name}: its focal length fits better changed by "
        f"{found['focal_change']:+.1%} (+- {found['focal_change_sigma']:.1%}); "
        "check its intrinsics and the size of its images, or say --refine focal"
        for name, found in changes.items()
    ]


def _cameras_with_fault(report: dict[str, Any], fault: str) -> list[str]:
    """Return the names of the cameras that have a fault."""
    return [camera["name"] for camera in report["cameras"] if fault in camera["faults"]]
