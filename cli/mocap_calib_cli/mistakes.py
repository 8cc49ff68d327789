"""A user's mistakes in one line: what was expected, what came, what to do."""

import errno

import click

from mocap_calib.errors import MocapCalibError, quote_for_shell, spell_as_option

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


def explain(error: Exception, command: click.Command | None = None) -> str | None:
    """Return the line for a user's mistake; None for one of the program, which gets a traceback.

    command: whose parameters the arguments in the line are, by their names.
    """
    options = {} if command is None else {each.name: each.opts[-1] for each in command.params}

    def spell(name: str, value: str) -> str:
        if name not in options:
            return spell_as_option(name, value)
        return f"{options[name]} {quote_for_shell(value)}".rstrip()

    if isinstance(error, MocapCalibError):
        return error.render(spell)
    if isinstance(error, OSError) and error.errno in _REMEDIES:
        return f"{error.filename or 'a file'}: {_REMEDIES[error.errno]}"
    return None
