"""TOML that is written: tables by name, every float with the digits that bring it back exactly."""

import json
import re
from collections.abc import Mapping
from typing import Any


def dump_toml(document: Mapping[str, Any]) -> str:
    """Return a document as TOML: of each table its values first, then the tables in it.

    Values are text, numbers, truth values and lists of them. TOML has no null: fields and entries
    that are None are left out.
    """
    return "\n\n".join(_dump_tables(document, ())) + "\n"


def _dump_tables(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    """Return the text of a table and of each table in it; `path` has the names that lead to it."""
    values = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
    tables = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in values.items() if value is not None]
    if path and (lines or not tables):
        lines.insert(0, f"[{'.'.join(map(_key, path))}]")
    texts = ["\n".join(lines)] if lines else []
    for key, inner in tables.items():
        texts += _dump_tables(inner, (*path, key))
    return texts


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _quote(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _quote(value)
    if isinstance(value, list):
        return f"[{', '.join(_value(entry) for entry in value if entry is not None)}]"
    if isinstance(value, Mapping):  # in a list
        fields = [f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None]
        return f"{{ {', '.join(fields)} }}"
    return repr(value)


def _quote(text: str) -> str:
    """Return a basic string: those of JSON, but that DEL is escaped too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
