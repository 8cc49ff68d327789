"""Which program this is: results follow from its code, which one version may have several of."""

import hashlib
from functools import cache
from pathlib import Path

from mocap_calib import __version__

_CODE = (".py", ".yaml")  # the weights are told apart by `lift.weights.identify_model`


@cache
def identify_program() -> str:
    """Return the version and the beginning of a hash of the code: "0.1.0 (code 1a2b3c4d5e6f)".

    It is the same on every system, and however the program was installed.
    """
    return f"{__version__} (code {hash_code(Path(__file__).parents[1])[:12]})"


def hash_code(package: Path) -> str:
    """Return one SHA-256 for the names and contents of the code and the skeletons in a package.

    package: its folder. Line ends count as one, since git may change them.
    """
    files = {
        file.relative_to(package).as_posix(): file
        for file in package.rglob("*")
        if file.suffix in _CODE
    }
    digest = hashlib.sha256()
    for name, file in sorted(files.items()):
        content = file.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()
