"""The README and its picture say what is so."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")


def load_script(path: Path) -> ModuleType:
    """Import a script that is in no package, and may import others beside it."""
    sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


def test_the_table_shows_all_recordings_and_their_verdicts():
    script = load_script(ROOT / "benchmarks" / "recordings.py")
    header = "| " + " | ".join(script.HEADER) + " |\n"
    assert script.HEADER[1] == "verdict"
    assert header in README
    table = README.split(header)[1].split("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[1:]]
    assert [row[0] for row in rows] == list(script.NAMES)
    for row in rows:
        assert re.match(r"well determined|usable|weak|not determined|refused", row[1])
        assert len(row) == len(script.HEADER)


def test_the_readme_has_one_picture_of_who_was_found():
    (picture,) = re.findall(r"!\[[^\]]*\]\(([^)]*)\)", README)
    path = ROOT / "docs" / picture.rpartition("/")[2]
    assert path.stat().st_size < 100_000
    words = {node.text for node in ElementTree.parse(path).iter() if node.tag.endswith("text")}
    assert {f"individual {k}" for k in range(3)} <= words
    assert {f"cam{k}" for k in range(1, 5)} <= words


def test_lines_of_the_readme_fit_a_page():
    """But for the rows of tables, which cannot be broken."""
    long = [line for line in README.splitlines() if len(line) > 100 and not line.startswith("|")]
    assert long == []
