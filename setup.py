"""Adds to setup.cfg what depends on the project's address, which stands there once."""

import re
from configparser import ConfigParser
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
PICTURE = re.compile(r"(!\[[^]]*\]\()(?![a-z]+:)")
LINK = re.compile(r"(?<!!)(\[[^]]*\]\()(?![a-z]+:|#)")


def read_address() -> str:
    """Return the address of the repository."""
    config = ConfigParser()
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    return config["metadata"]["url"]


def link_to(repository: str, text: str) -> str:
    """Return Markdown whose relative links work where the repository's files are not."""
    text = PICTURE.sub(rf"\1{repository}/raw/main/", text)
    return LINK.sub(rf"\1{repository}/blob/main/", text)


if __name__ == "__main__":
    address = read_address()
    setup(
        long_description=link_to(address, (ROOT / "README.md").read_text("utf-8")),
        long_description_content_type="text/markdown",
        project_urls={
            "Documentation": f"{address}/tree/main/docs",
            "Changes": f"{address}/blob/main/CHANGELOG.md",
            "Issues": f"{address}/issues",
        },
    )
