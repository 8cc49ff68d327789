"""Every reader against damaged files: it reads them or says in one line what is wrong; no
traceback, no hang, no flood of memory.

`make fuzz` runs it longer: FUZZ_EXAMPLES inputs for each of the formats.
"""

import json
import os
import random
import time

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from samples2d import SAMPLES, recording, write_sample

from mocap_calib.errors import MocapCalibError
from mocap_calib.io.keypoints.read import read_keypoints

resource = pytest.importorskip("resource", reason="needs POSIX, which counts the peak of memory")
EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "25"))
SECONDS = 5.0  # of computing for a file of some kilobytes
CLOCK = 60.0  # for what waits, on a busy machine; HDF5 is given 3 s of computing by itself
MEMORY = 1_000_000  # kB that one file may add to the peak
ODD = [
    *(
        None,
        True,
        False,
        "",
        "x",
        "null",
        "1,5",
        "NaN",
        [],
        {},
        [[]],
        {"a": 1},
        0,
        -1,
        1,
        2.5,
        1e308,
        -1e308,
        10**400,
        -(10**400),
    ),
    *(
        2**63,
        -(2**63),
        float("nan"),
        float("inf"),
        -float("inf"),
        "\u0000",
        "ä",
        "9" * 5000,
        "1e999",
        [1, [2, [3]]],
        [[1, 2], [3]],
    ),
]
CELLS = [
    "",
    " ",
    "x",
    "nan",
    "inf",
    "-1",
    "1e999",
    "9" * 400,
    '"',
    "1;2",
    "1,5",
    "\t",
    "0x10",
    "1_0",
    "\u0000",
    "-0",
    "1e5",
    "²",
    "scorer",
    "x,y",
]


def damage_json(value, rng):
    """The value with a few of its nodes replaced, doubled, cut or gone; now and then in a very deep
    list.
    """
    for _ in range(rng.randrange(1, 4)):
        value = _change(value, rng, rng.randrange(8))
    text = json.dumps(value)
    if rng.random() < 0.03:
        text = '{"people":' * 3000 + text if rng.random() < 0.5 else "[" * 100_000 + text
    return text


def _change(value, rng, depth):
    if depth and isinstance(value, dict) and value:
        key = rng.choice(list(value))
        return value | {key: _change(value[key], rng, depth - 1)}
    if depth and isinstance(value, list) and value:
        k = rng.randrange(len(value))
        return [*value[:k], _change(value[k], rng, depth - 1), *value[k + 1 :]]
    kind = rng.randrange(5)
    if kind == 0 and isinstance(value, list):
        return value * 2 if len(value) < 1000 else value[:1]
    if kind == 1 and isinstance(value, list | str):
        return value[: rng.randrange(len(value) + 1)]
    if kind == 2 and isinstance(value, dict) and value:
        gone = rng.choice(list(value))
        return {k: v for k, v in value.items() if k != gone}
    return rng.choice(ODD)


def damage_text(text, rng):
    """Cells replaced, rows doubled, cut, joined or in another order."""
    lines = text.splitlines()
    for _ in range(rng.randrange(1, 4)):
        k, kind = rng.randrange(len(lines)), rng.randrange(6)
        mark = "," if "," in lines[k] else " "
        cells = lines[k].split(mark)
        cells[rng.randrange(len(cells))] = rng.choice(CELLS)
        changed = {
            0: [mark.join(cells)],
            1: [mark.join(cells)],
            2: [lines[k]] * 2,
            3: [],
            4: [lines[k] + mark + "1"],
            5: [lines[k][: len(lines[k]) // 2]],
        }
        lines[k : k + 1] = changed[kind]
        lines = lines or [""]
    return "\n".join(lines)


def damage_bytes(content, rng):
    """Cut, bytes changed, anywhere or where something stands (HDF5 is mostly empty), another
    encoding, a mark of byte order.
    """
    kind = rng.randrange(8)
    if kind == 0:
        return content[: rng.randrange(len(content) + 1)]
    if kind == 1:
        return b"\xef\xbb\xbf" + content
    if kind == 2:
        return content.decode("latin-1").encode("utf-16")
    changed = bytearray(content)
    places = (
        np.flatnonzero(np.frombuffer(content, np.uint8)) if kind > 5 else np.arange(len(content))
    )
    for _ in range(rng.randrange(1, 20) if len(places) else 0):
        changed[min(int(rng.choice(places)) + rng.randrange(-4, 5), len(content) - 1)] = rng.choice(
            [0, 1, 255, rng.randrange(256)]
        )
    return bytes(changed)


def damage_hdf5(path, rng):
    """A dataset of another type, shape or size, or none; an attribute changed."""
    with h5py.File(path, "r+") as file:
        names = []
        file.visit(names.append)
        name = rng.choice(names)
        kind, item = rng.randrange(5), file[name]
        if kind == 0:
            del file[name]
        elif kind == 1 and item.attrs:
            attribute = rng.choice(list(item.attrs))
            item.attrs[attribute] = rng.choice(
                [b"x", 3.5, np.zeros(0), b"(lp0\n.", "json", b"{" * 5000, b"[" * 50_000, np.nan]
            )
        elif isinstance(item, h5py.Dataset):
            value = item[...]
            del file[name]
            if kind == 2:
                file[name] = rng.choice(
                    [
                        np.zeros(0),
                        np.zeros((2, 2)),
                        np.array([b"x"]),
                        np.float64(1),
                        np.full((3, 4, 5, 6), np.nan),
                        np.zeros(3, "i1"),
                    ]
                )
            elif kind == 3:
                file.create_dataset(
                    name,
                    shape=rng.choice([(2**40,), (2**31, 2), (0, 0), (10**5, 10**5)]),
                    dtype="f8",
                    chunks=True,
                )
            elif value.dtype.names:
                field = rng.choice(value.dtype.names)
                value[field] = np.array([rng.choice([0, 1, 2, 255, 2**31])]).astype(
                    value[field].dtype
                )
                file[name] = value
            else:
                file[name] = value[: len(value) // 2] if value.ndim else value
    return path.read_bytes()


def damaged(path, rng):
    """The file's bytes, damaged by what it is."""
    content = path.read_bytes()
    if rng.random() < 0.3:
        return damage_bytes(content, rng)
    if path.suffix == ".json":
        return damage_json(json.loads(content), rng).encode("utf-8", "surrogatepass")
    if path.suffix in (".csv", ".txt"):
        return damage_text(content.decode(), rng).encode()
    if path.suffix in (".h5", ".nc", ".nwb", ".slp"):
        return damage_hdf5(path, rng)
    return damage_bytes(content, rng)


def spent():
    """Seconds of computing, and by the clock."""
    return np.array([time.process_time(), time.perf_counter()])


class Originals(dict):
    """Short in words, so that a failure can be read."""

    def __repr__(self):
        return "originals"


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """Path -> content of the files of each format."""
    found = Originals()
    for name, (_, _, _, most, scores, _) in SAMPLES.items():
        folder = tmp_path_factory.mktemp("fuzz")
        write_sample(name, folder, *recording(most, scores=scores))
        found[name] = (
            folder,
            {
                path.relative_to(folder): path.read_bytes()
                for path in folder.rglob("*")
                if path.is_file()
            },
        )
    return found


@pytest.mark.parametrize("name", SAMPLES)
@settings(
    max_examples=EXAMPLES,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.generate],
    derandomize=EXAMPLES < 100,
    database=None,
)
@given(seed=st.integers(0, 2**63))
def test_damage_is_read_or_refused(originals, name, seed):
    rng = random.Random(seed)
    folder, contents = originals[name]
    path = rng.choice(sorted(contents))
    (folder / path).write_bytes(damaged(folder / path, rng))
    begun, peak = spent(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    said = "expected"
    try:
        views = read_keypoints(
            sorted(folder.iterdir()), rng.choice([None, SAMPLES[name][0]]), SAMPLES[name][2]
        )
        assert all(
            np.isfinite(view.confidence).all() and (np.diff(view.frames) > 0).all()
            for view in views
        )
    except MocapCalibError as error:
        said = str(error)
    finally:
        (folder / path).write_bytes(contents[path])
    assert "expected" in said
    assert "\n" not in said
    assert len(said) < 1500
    assert (spent() - begun < (SECONDS, CLOCK)).all()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < MEMORY
