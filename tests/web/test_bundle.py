"""The bundle of the report is that of the sources in web/."""

import hashlib
import json
import re
from importlib import resources
from pathlib import Path

import pytest

WEB = Path(__file__).parents[2] / "web"


@pytest.mark.parametrize("name", ["page.js", "page.css"])
def test_the_bundle_is_made_of_these_sources(name):
    """Otherwise: `make web`, and commit what it makes."""
    paths = [
        f"src/{path.name}" for path in (WEB / "src").iterdir() if path.suffixes != [".d", ".ts"]
    ]
    digest = hashlib.sha256()
    for path in sorted(["package.json", "build.mjs", *paths]):
        digest.update((WEB / path).read_bytes())
    text = (resources.files("mocap_calib.html_report") / name).read_text(encoding="utf-8")
    assert re.findall(r"of sources ([0-9a-f]{64})", text) == [digest.hexdigest()]


def test_the_bundle_has_its_licences_and_is_small():
    text = (resources.files("mocap_calib.html_report") / "page.js").read_text(encoding="utf-8")
    packages = json.loads((WEB / "package.json").read_text())["devDependencies"]
    for name in ("three", "uplot"):
        assert f"{name} {packages[name]}" in text
    assert text.count("THE SOFTWARE IS PROVIDED") == 2
    assert len(text) < 800_000  # 716,000


def test_no_address_of_a_registry_is_in_the_lock_file():
    lock = json.loads((WEB / "package-lock.json").read_text())
    packages = [each for path, each in lock["packages"].items() if path]
    assert packages
    assert all("resolved" not in each and each["integrity"] for each in packages)


def test_markup_is_never_made_of_text():
    """Elements are made by `dom.ts`, whose children are text."""
    for path in (WEB / "src").glob("*.ts"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(", text)
        # style attributes would break the page's policy
        assert not re.search(r"setAttribute\(.style|\bstyle: ", text), path
