"""Make a set of 3D poses to train on, of arrays in a publisher's files.

    .venv/bin/python benchmarks/poses_of_arrays.py SET FILE:ARRAY ... --joints Nose,EarL,...

FILE is HDF5, MATLAB's or numpy's; ARRAY is the name of an array of poses, points and three
coordinates, in any order of its axes that the lengths tell apart, or of a row of coordinates for
each pose. What lies inside a structure of MATLAB's is named as labelData.0.data_3d. SET is a
folder, which `mocap-calib train` reads; each FILE is a clip of it. --joints names the points in
their order, or is a YAML or JSON file with such a list; --key says below which key it stands.

The sets that the model cards name are made so (benchmarks/README.md).
"""

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml
from common import make_parser
from scipy.io import loadmat

from mocap_calib.errors import FormatError
from mocap_calib.types import Floats


def main() -> None:
    """Read an array, and write a set."""
    parser = make_parser(__doc__)
    parser.add_argument("out", type=Path, metavar="SET")
    parser.add_argument("sources", nargs="+", metavar="FILE:ARRAY")
    parser.add_argument("--joints", required=True, help="names, or a file that has them")
    parser.add_argument("--key", default="", help="where in that file")
    options = parser.parse_args()
    try:
        joints = names_of(options.joints, options.key)
        clips = [read_clip(source, len(joints)) for source in options.sources]
    except FormatError as error:
        sys.exit(str(error))
    options.out.mkdir(parents=True, exist_ok=True)
    number = np.repeat(np.arange(len(clips)), [len(clip) for clip in clips])
    poses = np.concatenate(clips).astype(np.float32)
    np.savez_compressed(options.out / "poses3d.npz", poses3d=poses, clip=number)
    (options.out / "joints.json").write_text(json.dumps({"names": joints}, indent=1), "utf-8")


def names_of(text: str, key: str) -> list[str]:
    """Return the names of the points. Raises FormatError where a file has none below the key."""
    if not Path(text).is_file():
        return text.split(",")
    found = yaml.safe_load(Path(text).read_text("utf-8"))  # JSON is YAML
    for part in filter(None, key.split(".")):
        found = found.get(part) if isinstance(found, dict) else None
    if not isinstance(found, list):
        raise FormatError(text, f"a list of names at {key or 'the top'}", "none", "check the key")
    return [str(name) for name in found]


def read_clip(source: str, joints: int) -> Floats:
    """Return the poses `[S, J, 3]` of FILE:ARRAY. Raises FormatError."""
    path, _, name = source.rpartition(":")
    return as_poses(read_array(Path(path), name), joints, Path(path))


def read_array(path: Path, name: str) -> Floats:
    """Return an array of a file. Raises FormatError."""
    try:
        if path.suffix == ".npz":
            with np.load(path) as file:
                return np.asarray(file[name], dtype=float)
        if h5py.is_hdf5(path):
            with h5py.File(path) as file:
                return np.asarray(file[name], dtype=float)
        found: Any = loadmat(path, simplify_cells=True)
        for part in name.split("."):
            found = found[int(part)] if part.isdigit() else found[part]
        return np.asarray(found, dtype=float)
    except (OSError, KeyError, ValueError, TypeError, IndexError) as error:
        raise FormatError(path, f"an array {name}", str(error), "check its name") from None


def as_poses(array: Floats, joints: int, path: Path) -> Floats:
    """Return poses `[S, J, 3]` of an array whose axes have another order. Raises FormatError."""
    array = array.squeeze()
    if array.ndim == 2 and array.shape[1] == 3 * joints:
        return array.reshape(-1, joints, 3)
    for order in ((0, 1, 2), (0, 2, 1), (2, 1, 0), (2, 0, 1), (1, 0, 2), (1, 2, 0)):
        if array.ndim == len(order) and array.transpose(order).shape[1:] == (joints, 3):
            return array.transpose(order)
    raise FormatError(path, f"poses of {joints} points", f"shape {array.shape}", "check the names")


if __name__ == "__main__":
    main()
