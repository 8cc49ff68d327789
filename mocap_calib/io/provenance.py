"""What a result file says of how it came about."""

from collections.abc import Mapping
from typing import Any

from mocap_calib import __version__


def provenance(command: str, **fields: Any) -> Mapping[str, Any]:
    """Return the command, the version, and further fields (seed, hashes of the inputs, ...)."""
    return {"command": f"mocap-calib {command}", "version": __version__, **fields}
