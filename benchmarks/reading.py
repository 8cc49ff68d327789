"""Reading a DeepLabCut .csv, .h5 and COCO .json of 30,000 frames x 4 animals, beside pandas.

    .venv/bin/python benchmarks/reading.py

Each reader runs in a process of its own: seconds and processor seconds are the best of several
reads, the memory is what the first read adds at most to the process that has imported what it
needs. pandas (and PyTables, for .h5) come with other packages, or not at all: then they are left out.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

FRAMES, ANIMALS, PARTS = 30_000, 4, 17
READS = 5
FILES = ("cam1.csv", "cam1.h5", "cam1.json")

READ = """
import json, resource, sys, time
from multiprocessing import Value
which, path, reads = sys.argv[1], sys.argv[2], int(sys.argv[3])
if which == "mocap-calib":
    from mocap_calib.compute.kernels import compiled
    from mocap_calib.io.keypoints import formats
    from mocap_calib.io.keypoints.read import read_keypoints
    compiled("mocap_calib.io.keypoints.table_kernels")
    read = lambda: read_keypoints(path)
elif path.endswith(".csv"):
    import pandas
    read = lambda: pandas.read_csv(path, header=[0, 1, 2, 3], index_col=0)
elif path.endswith(".h5"):
    import h5py
    read = lambda: {k: v[...] for k, v in h5py.File(path)["df_with_missing"].items()}
else:
    read = lambda: json.load(open(path, encoding="utf-8"))

def peak():
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(kind).ru_maxrss for kind in kinds) / 1e3

def cpu():
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    used = [resource.getrusage(kind) for kind in kinds]
    return sum(each.ru_utime + each.ru_stime for each in used)

before, found = peak(), []
for number in range(reads):
    start, used = time.perf_counter(), cpu()
    held = read()
    found.append((time.perf_counter() - start, cpu() - used))
    del held
    if number == 0:
        memory = peak() - before
print(json.dumps([min(each) for each in zip(*found)] + [memory]))
"""


def write_files(folder: Path) -> None:
    """Write the files of one scene: wandering points, of which a twentieth is missing."""
    from mocap_calib.io.keypoints.write import write_keypoints  # noqa: PLC0415
