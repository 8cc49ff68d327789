"""Results follow from the code: other code is another program, another system is not."""

import re
import shutil
from pathlib import Path

import pytest

import mocap_calib
from mocap_calib import compute

PACKAGE = Path(mocap_calib.__file__).parent


@pytest.fixture
def package(tmp_path) -> Path:
    """A few files as a package has them."""
    (tmp_path / "skeletons").mkdir()
    (tmp_path / "a.py").write_bytes(b"one = 1\ntwo = 2\n")
    (tmp_path / "skeletons" / "b.yaml").write_bytes(b"name: b\n")
    return tmp_path


def test_the_program_is_its_version_and_its_code():
    found = compute.identify_program()
    assert re.fullmatch(rf"{re.escape(mocap_calib.__version__)} \(code [0-9a-f]{{12}}\)", found)
    assert compute.hash_code(PACKAGE)[:12] in found


def test_line_ends_and_what_python_leaves_behind_are_no_other_code(package):
    before = compute.hash_code(package)
    (package / "a.py").write_bytes(b"one = 1\r\ntwo = 2\r\n")
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "a.cpython-311.pyc").write_bytes(b"compiled")
    assert compute.hash_code(package) == before
    shutil.copytree(package, package.parent / "elsewhere")
    assert compute.hash_code(package.parent / "elsewhere") == before


def test_a_change_of_code_name_or_skeleton_is_other_code(package):
    found = {compute.hash_code(package)}
    (package / "a.py").write_bytes(b"one = 1\ntwo = 3\n")
    found.add(compute.hash_code(package))
    (package / "a.py").rename(package / "c.py")
    found.add(compute.hash_code(package))
    (package / "skeletons" / "b.yaml").write_bytes(b"name: c\n")
    found.add(compute.hash_code(package))
    assert len(found) == 4
