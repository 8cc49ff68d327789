"""Kernels are loaded as machine code, without numba, and compiled again where that is not right."""

import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

from mocap_calib.kernels import jit, machine_code

pytest.importorskip("numba")
SOURCE = """
import numpy as np
from mocap_calib.kernels.jit import FLOAT, changed_floats, floats, inlined, kernel

@inlined
def twice(x):
    return FACTOR * x

FACTOR = 2.0

@kernel(floats(1), FLOAT, changed_floats(2))
def fill(row, offset, table):
    before = np.empty(len(row))
    for i in range(len(row)):
        before[i] = twice(row[i]) + offset
    for j in range(len(table)):
        table[j] = before
    return before.sum()
"""
LOADED = """
import sys
import numpy as np
from importlib.util import module_from_spec, spec_from_file_location
spec = spec_from_file_location("some_kernels", sys.argv[1])
module = module_from_spec(spec)
spec.loader.exec_module(module)
table = np.zeros((2, 3))
print(module.fill(np.arange(3.0), 1.0, table), *table[1], "numba" in sys.modules)
"""


@pytest.fixture
def source(tmp_path) -> Path:
    path = tmp_path / "some_kernels.py"
    path.write_text(SOURCE, "utf-8")
    return path


def load(source: Path):
    spec = spec_from_file_location("some_kernels", source)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.fill


def run_elsewhere(source: Path) -> str:
    return subprocess.check_output([sys.executable, "-c", LOADED, source], text=True).strip()


def test_machine_code_gives_what_numba_gives_without_numba(source):
    row, table = np.random.default_rng(0).normal(size=4), np.zeros((3, 4))
    compiled = load(source)
    assert hasattr(compiled, "overloads")
    expected = compiled(row, 0.3, table), table.copy()
    kept = load(source)
    assert not hasattr(kept, "overloads")
    assert kept(row, 0.3, table) == expected[0]
    np.testing.assert_array_equal(table, expected[1])
    np.testing.assert_array_equal(table[2], 2 * row + 0.3)
    assert run_elsewhere(source) == "9.0 1.0 3.0 5.0 False"


def test_changed_code_is_linked_beside_code_of_the_same_name(source):
    """Whoever holds the function as it was keeps it."""
    row, table = np.arange(3.0), np.zeros((2, 3))
    load(source)
    before = load(source)
    # Python takes a file for unchanged that has its size and second
    source.write_text(SOURCE.replace("FACTOR = 2.0", "FACTOR = 50.0"), "utf-8")
    load(source)
    after = load(source)
    assert not hasattr(after, "overloads")
    assert [kernel(row, 1.0, table) for kernel in (before, after, before)] == [9.0, 153.0, 9.0]


@pytest.mark.parametrize("damage", ["changed source", "cut off", "garbage", "other machine"])
def test_what_is_not_right_is_compiled_again(source, damage, monkeypatch):
    load(source)
    (place,) = (source.parent / "__pycache__").glob("*.machine")
    whole = place.read_bytes()
    if damage == "changed source":
        source.write_text(SOURCE.replace("FACTOR = 2.0", "FACTOR = 30.0"), "utf-8")
    if damage == "cut off":
        place.write_bytes(whole[:-2000])
    if damage == "garbage":
        place.write_bytes(whole[:64] + b"no pickle")
    if damage == "other machine":
        monkeypatch.setattr(machine_code, "_machine", lambda: "another")
        monkeypatch.setattr(machine_code, "_FITS", source.parent / "fits")
    table = np.zeros((1, 1))
    found = load(source)
    assert hasattr(found, "overloads")
    assert found(np.ones(1), 0.0, table) == (30 if damage == "changed source" else 2)
    assert not hasattr(load(source), "overloads")  # kept again


@pytest.mark.parametrize(
    "table",
    [
        np.zeros((2, 3), dtype=np.float32),
        np.zeros(3),
        np.zeros((3, 2)).T,
        np.broadcast_to(0.0, (2, 3)),
    ],
    ids=["single", "dimensions", "order", "read only"],
)
def test_arrays_of_other_types_are_refused(source, table):
    load(source)
    with pytest.raises(TypeError, match=r"argument 2: expected .*float64.*=2"):
        load(source)(np.ones(3), 0.0, table)


def test_nothing_is_kept_where_nothing_can_be_written(source, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(Path, "write_bytes", refuse)
    assert hasattr(load(source), "overloads")
    assert not list((source.parent / "__pycache__").glob("*.machine"))
    assert jit.numba_fits()
