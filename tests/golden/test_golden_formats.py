"""What `convert` makes of one small file of each format, sound and damaged.

The outcomes are in `expected.json` and `messages.txt`; `make.py` writes them anew.
"""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest
from conformance import CORPUS, TARGETS
from golden.cases import (
    Conversion,
    as_block,
    conversions,
    damages,
    load_expected,
    load_messages,
)
from golden.command import call
from golden.digests import canonical, digest
from golden.refusals import REFUSALS

ROOT = Path(__file__).parents[2]
EXPECTED, MESSAGES = load_expected(), load_messages()
REMADE = "see tests/golden/make.py"
NOT_HERE = {"nwb-3d": "ndx_pose", "rerun": "rerun"}  # formats that other packages write


@pytest.mark.parametrize("case", conversions(), ids=lambda case: case.name)
def test_a_sound_file_is_converted_as_before(case, tmp_path):
    assert case.outcome(tmp_path) == EXPECTED[case.name], REMADE


@pytest.mark.parametrize("case", damages(), ids=lambda case: case.name)
def test_a_damaged_file_is_refused_as_before(case, tmp_path):
    found = case.outcome(tmp_path)
    assert found["status"] in (0, 1)
    if found["status"]:
        assert len(found["stderr"]) == 1, "a refusal is one line"
        assert found["stderr"][0].startswith("mocap-calib: ")
        assert not found["files"], "nothing is written"
    assert as_block(case.name, found) == MESSAGES[case.name], REMADE


def test_no_outcome_is_left_over():
    assert list(EXPECTED) == [case.name for case in conversions()]
    assert list(MESSAGES) == [*(case.name for case in damages()), *REFUSALS]


def test_every_documented_format_is_in_the_corpus():
    """The tables of docs/formats.md say which formats are read and written."""
    text = (ROOT / "docs" / "formats.md").read_text("utf-8")
    titles = {
        "keypoints": "## Keypoint files",
        "cameras": "## Camera files",
        "poses": "## 3D files",
    }
    for kind, title in titles.items():
        section = text.split(title)[1].split("\n## ")[0]
        table = [[cell.strip() for cell in row.split("|")[1:-1]] for row in _table(section)]
        read, written = (table[0].index(word) for word in ("read", "written"))
        rows = {row[0].strip("`"): row for row in table[2:]}
        assert {name for name, row in rows.items() if row[written]} - set(NOT_HERE) == set(
            TARGETS[kind]
        )
        there = {path.name for path in (CORPUS / kind).iterdir()}
        assert {name for name, row in rows.items() if row[read]} <= there


def _table(text: str) -> list[str]:
    """Return the rows of the first table of a text."""
    found = re.search(r"(?:^\|.*\n)+", text, re.M)
    assert found
    return found.group().splitlines()


@pytest.mark.parametrize("form", NOT_HERE)
def test_a_format_of_another_package_is_written_or_the_package_named(form, tmp_path):
    case = Conversion("poses/npz", form)
    done = case.run(tmp_path)
    if find_spec(NOT_HERE[form]) is None:
        assert done.status == 1
        assert len(done.stderr) == 1
        assert "pip install" in done.stderr[0]
    else:
        assert done.status == 0
        assert (tmp_path / "out" / form).stat().st_size


PIPES = {  # kind: the formats of a chain, and the files of each; keypoints of a pipe are of `stdin`
    "cameras": {"anipose": "a.toml", "nerfstudio": "b.json", "mocap-calib": "c.yaml"},
    "keypoints": {"deeplabcut-csv": "stdin.csv", "movement": "stdin.nc", "csv": "c.csv"},
    "poses": {"npz": "a.npz", "c3d": "b.c3d", "poses-h5": "c.h5"},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", PIPES)
def test_a_chain_of_pipes_gives_what_files_give(kind, tmp_path):
    """Two conversions by stdin and stdout in processes of their own, and two by files."""
    chain = PIPES[kind]
    (path,) = (CORPUS / kind / next(iter(chain))).iterdir()
    content = path.read_bytes()
    (tmp_path / next(iter(chain.values()))).write_bytes(content)
    for source, target in pairwise(chain):
        done = subprocess.run(
            [sys.executable, "-m", "mocap_calib_cli", "convert", "-", "-", "-q"]
            + ["--from", source, "--to", target],
            input=content,
            capture_output=True,
            check=False,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "cli")])},
        )
        assert (done.returncode, done.stderr) == (0, b"")
        content = done.stdout
        by_file = call("convert", chain[source], chain[target], "--to", target, folder=tmp_path)
        assert by_file.status == 0, by_file.stderr
    assert _without_inputs(content) == _without_inputs((tmp_path / chain[target]).read_bytes())


def _without_inputs(content: bytes) -> str:
    """Return the content without the names and hashes of what it was made of."""
    return re.sub(r"\n +(inputs:( {})?|\S+: [0-9a-f]{64})(?=\n)", "", canonical(content))


def test_digests_see_a_change_of_a_number_and_of_a_name():
    assert digest(b"a 0.1234567891\n") == digest(b"a 0.12345678911\n")
    assert digest(b"a 0.1234567891\n") != digest(b"a 0.1234568\n")
    assert digest(b"a -0.0 1e-17\n") == digest(b"a 0.0 0.0\n")
    assert digest(b"a 0.5\n") != digest(b"b 0.5\n")
    content = (CORPUS / "keypoints" / "sleap" / "cam.analysis.h5").read_bytes()
    assert digest(content) != digest(content.replace(b"left_ear", b"left_eye"))
