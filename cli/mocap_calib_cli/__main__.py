"""The program `mocap-calib`; as `python -m mocap_calib_cli` where scripts are not on the path."""

import atexit
import gc
import os
import sys
from typing import NoReturn

from mocap_calib.compute import keep_freed_memory

# objects made before they are searched for cycles, of which there are next to none: Python's own
# number costs a tenth of a second for each three seconds of work
_OBJECTS_OF_A_SEARCH = 100_000


def run() -> None:
    """Run the command in a process that ends with it."""
    gc.set_threshold(_OBJECTS_OF_A_SEARCH)
    keep_freed_memory()
    try:
        from mocap_calib_cli.main import main
    except Exception as error:  # in click, the one package that is imported here
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        sys.exit(f"wrong: click cannot be imported ({reason}); install it again")
    try:
        main()
    except SystemExit as end:
        _end_at_once(end)


def _end_at_once(end: SystemExit) -> NoReturn:
    """End the process without freeing one by one what it holds: that takes up to half a second.

    What was registered to be done at the end is done.
    """
    if end.code is not None and not isinstance(end.code, int):
        raise end
    atexit._run_exitfuncs()
    try:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # its reader has gone
                stream.flush()
    except OSError:  # Python says what it is
        raise end from None
    os._exit(end.code or 0)


if __name__ == "__main__":
    run()
