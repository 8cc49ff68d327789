"""Plain tables of DeepLabCut are read in blocks: the same as cell by cell."""

import random
import struct

import numpy as np
import pytest

from mocap_calib.io.keypoints import deeplabcut_csv
from mocap_calib.io.keypoints.read import read_keypoints

COLUMNS = deeplabcut_csv._Columns(1, 2, ("coords",), (("x",),), has_sets=False)


def test_numbers_are_read_as_float_reads_them():
    """To the last bit; 5,000 texts of 1 to 19 digits."""
    rng = random.Random(0)
    texts = [repr(rng.uniform(-2000, 2000)) for _ in range(2000)]
    texts += [f"{rng.uniform(0, 2000):.18e}" for _ in range(2000)]
    texts += [f"{rng.randrange(10**9)}e{rng.randrange(-40, 8)}" for _ in range(1000)]
    block = "".join(f"a,{text}\n" for text in texts)
    _, values = deeplabcut_csv._parse_block(block, COLUMNS)
    wanted = struct.pack("5000d", *map(float, texts))
    assert np.ascontiguousarray(values[:, 0]).tobytes() == wanted


@pytest.mark.parametrize("row", ["a,-", "a,1.2.3", "a,1e", 'a,"1"', "a,1,2", ",1", "a", "", "a,b"])
def test_odd_rows_are_left_to_the_careful_reader(row):
    with pytest.raises(ValueError, match=r"."):
        deeplabcut_csv._parse_block(f"a,1.5\n{row}\n", COLUMNS)


def test_a_table_reads_equal_both_ways(tmp_path, monkeypatch):
    header = "scorer,s,s,s,s,s,s\nbodyparts,a,a,a,b,b,b\ncoords" + 2 * ",x,y,likelihood" + "\n"
    rows = "".join(f"{k},{k}.25,1e1,0.5,,,\r\n" for k in range(50))
    path = tmp_path / "cam1.csv"
    path.write_text(header + rows, encoding="utf-8", newline="")
    with monkeypatch.context() as patch:
        patch.setattr(deeplabcut_csv, "_read_plain_table", lambda _: None)
        careful = read_keypoints(path)[0]
    monkeypatch.setattr(deeplabcut_csv, "_read_any_table", None)
    assert read_keypoints(path)[0] == careful
