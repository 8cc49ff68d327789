"""Comments at the head of camera files, where their syntax has comments."""

from collections.abc import Mapping, Sequence
from pathlib import PurePath

_WITH_COMMENTS = (".toml", ".yaml", ".yml", ".txt")
_FILE_STORAGE = b"%YAML:1.0\n---\n"  # OpenCV's header comes before any comment


def add_comments(files: Mapping[str, bytes], lines: Sequence[str]) -> dict[str, bytes]:
    """Return the files (relative path -> content) with the lines at their head, as comments.

    JSON and binary files stay as they are.
    """
    comment = "".join(f"# {line}\n" for line in lines).encode()
    return {name: _add_comment(name, content, comment) for name, content in files.items()}


def _add_comment(name: str, content: bytes, comment: bytes) -> bytes:
    """Return the content of a file with a comment at its head, if it can have one."""
    if PurePath(name).suffix not in _WITH_COMMENTS:
        return content
    header = _FILE_STORAGE if content.startswith(_FILE_STORAGE) else b""
    return header + comment + content.removeprefix(header)
