"""A user's mistakes in one line: what was expected, what came, what to do."""

import errno

from mocap_calib.errors import MocapCalibError

_REMEDIES = {
    errno.ENOENT: "expected a file or folder, found none; check the path",
    errno.EACCES: "expected a path this program may use, found permission denied; "
    "change its permissions or choose another",
    errno.EPERM: "expected a path this program may use, found operation not permitted; "
    "choose another",
    errno.EROFS: "expected a place to write to, found a read-only file system; choose another",
    errno.EISDIR: "expected a file, found a folder; give the file itself",
    errno.ENOTDIR: "expected a folder, found a file on the way; choose another path",
    errno.EEXIST: "expected a folder, found a file of that name; choose another path",
    errno.ENOSPC: "expected room to write, found a full disk; free some",
    errno.EDQUOT: "expected room to write, found the quota used up; free some",
}


def explain(error: Exception) -> str | None:
    """Return the line for a user's mistake; None for one of the program, which gets a traceback."""
    if isinstance(error, MocapCalibError):
        return " ".join(str(error).split())
    if isinstance(error, OSError) and error.errno in _REMEDIES:
        return f"{error.filename or 'a file'}: {_REMEDIES[error.errno]}"
    return None
