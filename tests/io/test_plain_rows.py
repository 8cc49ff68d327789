"""Large tables by the compiled reader: the same as cell by cell."""

import random
import struct

import numpy as np
import pytest

from mocap_calib.io.keypoints import deeplabcut_csv
from mocap_calib.io.keypoints.plain_rows import read_plain_rows
from mocap_calib.io.keypoints.read import read_keypoints


def test_the_kernel_reads_numbers_as_float_does():
    """To the last bit; 5,000 texts of 1 to 19 digits."""
    rng = random.Random(0)
    texts = [repr(rng.uniform(-2000, 2000)) for _ in range(2000)]
    texts += [f"{rng.uniform(0, 2000):.18e}" for _ in range(2000)]
    texts += [f"{rng.randrange(10**9)}e{rng.randrange(-40, 8)}" for _ in range(1000)]
    block = "".join(f"a,{text}\n" for text in texts).encode()
    found = read_plain_rows([block], len(block), [False, True])
    assert found is not None
    wanted = struct.pack("5000d", *map(float, texts))
    assert np.ascontiguousarray(found.values[:, 0]).tobytes() == wanted


@pytest.mark.parametrize(
    "cell", ["-", ".5", "1.2.3", "1e", "nan", " 1", '"1"', "1,2", "18446744073709551616", "1_0"]
)
def test_odd_rows_are_left_to_the_careful_reader(cell):
    assert read_plain_rows([b"a,1.5\n" + f"a,{cell}\n".encode()], 20, [False, True]) is None


def test_a_table_reads_equal_both_ways(tmp_path, monkeypatch):
    header = "scorer,s,s,s,s,s,s\nbodyparts,a,a,a,b,b,b\ncoords" + 2 * ",x,y,likelihood" + "\n"
    rows = "".join(f"{k},{k}.25,1e1,0.5,,,\r\n" for k in range(50))
    path = tmp_path / "cam1.csv"
    path.write_text(header + rows, encoding="utf-8", newline="")
    careful = read_keypoints(path)[0]
    monkeypatch.setattr(deeplabcut_csv, "_LARGE", 0)
    monkeypatch.setattr(deeplabcut_csv, "_read_any_table", None)
    assert read_keypoints(path)[0] == careful
