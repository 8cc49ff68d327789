"""Nothing is dropped in silence: numbers that no reader uses are named once, in every format.

A file of each format of the corpus gets a number under a name that its program does not write, a
column or a data set of that name, and a point without a score.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conformance import CORPUS, KEYPOINTS
from scipy.io import loadmat, savemat

import mocap_calib as mc
from mocap_calib.io.camera_files import load_cameras

NEW = "unknown_number"
SCORED = ("keypoints", "pose_keypoints_2d", "keypoint_scores", "visible", "bodyparts")
# their numbers have no names, or those are what there is of keypoints; XML, pickles, .npy
WITHOUT_NAMES = {
    *("ultralytics", "jarvis-2d", "colmap", "colmap-binary", "sleap-slp", "dlt", "dltdv"),
    *("metashape", "vicon", "qualisys", "opencap", "freemocap-2d", "ultralytics-csv"),
}
CASES = sorted(
    (kind, path.name)
    for kind in ("keypoints", "cameras")
    for path in (CORPUS / kind).iterdir()
    if path.name not in WITHOUT_NAMES
)


def add_to_tree(value: Any) -> None:
    """Add the number to each mapping that holds the numbers of a point or of a camera."""
    if isinstance(value, dict):
        if any(isinstance(each, list | int | float) for each in value.values()):
            value[NEW] = 1.5
        for each in list(value.values()):
            add_to_tree(each)
    elif isinstance(value, list):
        for each in value:
            add_to_tree(each)


def drop_score(value: Any, name: str = "") -> bool:
    """Take the score from the first point."""
    if name in SCORED and isinstance(value, list):
        while isinstance(value[0], list):
            value = value[0]
        if len(value) > 2:  # not x and y alone
            value[0 if name in ("keypoint_scores", "visible") else 2] = None
            return True
    named = value.items() if isinstance(value, dict) else ()
    listed = ((name, each) for each in value) if isinstance(value, list) else ()
    return any(drop_score(each, key) for key, each in (*named, *listed))


def change_json(path: Path) -> None:
    tree = json.loads(path.read_text("utf-8"))
    drop_score(tree)
    add_to_tree(tree)
    path.write_text(json.dumps(tree), "utf-8")


def change_csv(path: Path) -> None:
    text = path.read_text("utf-8")
    separator = max(",;\t", key=text.splitlines()[0].count)
    rows = [line.split(separator) for line in text.splitlines()]
    head = next((k for k, row in enumerate(rows) if row[0] == "coords"), 0)
    for k, row in enumerate(rows):
        row.append((NEW if k == head else row[-1]) if k <= head else "1.5")
    cells = [cell.lower().strip('"') for cell in rows[head]]
    for score in ("score", "likelihood", "p"):  # of a point, beside whose column is one of x
        for k, cell in enumerate(cells):
            if cell.endswith(score) and cell.removesuffix(score) + "x" in cells:
                rows[head + 1][k] = ""
    path.write_text("\n".join(map(separator.join, rows)) + "\n", "utf-8")


def change_hdf5(path: Path) -> None:
    def change(name: str, item: Any) -> None:
        if item.attrs.get("neurodata_type") in (b"PoseEstimation", "PoseEstimation"):
            top.insert(0, item)
        elif name.rpartition("/")[2] in ("point_scores", "confidence"):
            item[(0,) * item.ndim] = np.nan
        elif name.endswith("block0_values"):
            item[0, 2] = np.nan
        elif name.endswith("/table"):
            rows = item[...]
            rows["values_block_0"][0, 2] = np.nan
            item[...] = rows

    with h5py.File(path, "a") as file:
        top = [file]
        file.visititems(change)
        top[0][NEW] = np.arange(3.0)


def change_mat(path: Path) -> None:
    found = {name: each for name, each in loadmat(path).items() if not name.startswith("__")}
    savemat(path, found | {NEW: 1.5})


def change_text(path: Path) -> None:
    """Add the number to the first section of TOML, to the first camera of YAML or to its top."""
    lines = path.read_text("utf-8").splitlines()
    toml = path.suffix == ".toml"
    first = next((k for k, line in enumerate(lines) if line.startswith("[") and toml), None)
    nested = next(
        (k for k, line in enumerate(lines) if line.strip().startswith("resolution")), None
    )
    place = len(lines) if first is nested is None else (first if nested is None else nested - 1) + 1
    indent = "" if nested is None else "  "
    lines.insert(place, f"{indent}{NEW}{' =' if toml else ':'} 1.5")
    path.write_text("\n".join(lines) + "\n", "utf-8")


CHANGES = {
    **{".json": change_json, ".csv": change_csv, ".mat": change_mat},
    **dict.fromkeys((".h5", ".nc", ".nwb", ".slp"), change_hdf5),
}


@pytest.mark.parametrize(("kind", "name"), CASES, ids=map("/".join, CASES))
def test_what_is_not_used_is_named_once(kind, name, tmp_path):
    shutil.copytree(CORPUS / kind / name, tmp_path / "in")
    files = [file for file in sorted((tmp_path / "in").rglob("*")) if file.is_file()]
    for file in files:
        CHANGES.get(file.suffix, change_text)(file)
    whole = tmp_path / "in" if len(files) > 1 else files[0]
    if kind == "cameras":
        said = load_cameras(whole).notes
    else:
        options = mc.ReadOptions(**KEYPOINTS[name].options)
        view = mc.read_keypoints(whole, options=options)[0]
        said = view.remarks
        bare = [remark for remark in said if "without a score" in remark or "no scores" in remark]
        assert len(bare) == 1, said
        assert np.isfinite(view.positions[0]).any()
    unused = [line for line in said if "not used" in line]
    assert len(unused) == 1, said
    assert unused[0].split(" not used: ")[1].split(", ").count(NEW) == 1
