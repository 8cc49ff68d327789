"""Reading a DeepLabCut .csv of 30,000 frames x 4 animals, beside pandas.

    .venv/bin/python benchmarks/reading.py

Each reader runs in a process of its own: seconds and processor seconds are the best of several
reads, the memory is what the first read adds at most to the process that has imported what it
needs. pandas comes with xarray; where it is missing it is left out.
"""

import json
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

FRAMES, ANIMALS, PARTS = 30_000, 4, 17
READS = 5

READ = """
import json, resource, sys, time
which, path, reads = sys.argv[1], sys.argv[2], int(sys.argv[3])
if which == "mocap-calib":
    from mocap_calib.io.keypoints import formats
    from mocap_calib.io.keypoints.read import read_keypoints
    read = lambda: read_keypoints(path)
else:
    import pandas
    read = lambda: pandas.read_csv(path, header=[0, 1, 2, 3], index_col=0)

def peak():  # of this program: ru_maxrss begins with that of the program that started it
    status = open("/proc/self/status", encoding="ascii").read()
    return int(status.split("VmHWM:")[1].split()[0]) / 1e3

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


def write_csv(path: Path) -> None:
    """Write wandering points, a twentieth missing, as a .csv of DeepLabCut."""
    rng = np.random.default_rng(0)
    values = 500 + np.cumsum(rng.normal(size=(FRAMES, ANIMALS, PARTS, 3)), axis=0)
    values[..., 2] = rng.uniform(0.5, 1.0, values.shape[:3])
    values[rng.random((FRAMES, ANIMALS)) < 0.05] = np.nan
    columns = [
        ("net", f"animal_{animal}", f"part_{part}", coord)
        for animal in range(ANIMALS)
        for part in range(PARTS)
        for coord in ("x", "y", "likelihood")
    ]
    levels = zip(
        ("scorer", "individuals", "bodyparts", "coords"), zip(*columns, strict=True), strict=True
    )
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for level, labels in levels:
            file.write(",".join([level, *labels]) + "\n")
        for frame, row in enumerate(values.reshape(FRAMES, -1).tolist()):
            cells = ["" if cell != cell else repr(cell) for cell in row]  # noqa: PLR0124
            file.write(",".join([str(frame), *cells]) + "\n")


def measure_reading(folder: Path) -> dict[str, dict[str, float]]:
    """Return seconds, CPU seconds and MB of memory of ours and, where it is, of pandas."""
    path = folder / "cam1.csv"
    write_csv(path)
    readers = ["mocap-calib", *(["pandas"] if find_spec("pandas") else [])]
    found = {}
    for reader in readers:
        command = [sys.executable, "-c", READ, reader, str(path), str(READS)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        found[reader] = dict(zip(("seconds", "cpu", "mb"), json.loads(done.stdout), strict=True))
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        for name, figures in measure_reading(Path(scratch)).items():
            print(name, {key: round(value, 2) for key, value in figures.items()})
