"""Texts of help in docstrings: their last paragraph has a line `name: text` for each."""

import re


def split_help(text: str | None) -> tuple[str, dict[str, str]]:
    """Return a docstring without the texts of its last paragraph, and these by their names.

    text: without the indentation of the code; None where Python dropped it (-OO). A text goes on in
        lines that are indented.
    """
    about, _, last = (text or "").rpartition("\n\n")
    found = re.findall(r"^([a-z]\w*): (.*(?:\n .*)*)", last, re.M)
    helps = {name: " ".join(help.split()) for name, help in found}
    return about if helps else text or "", helps
