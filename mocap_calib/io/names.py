"""The names of cameras, which are those of files or stand in them."""

from mocap_calib.errors import FormatError
from mocap_calib.recording.names import compose_name


def camera_name(name: str, source: str) -> str:
    """Return the name of a camera as names are compared, see `compose_name`.

    source: the file that it is of.

    Raises FormatError where it is no text, as that of a file whose name is not UTF-8: no file that
    is written could hold it.
    """
    try:
        name.encode()
    except UnicodeEncodeError:
        remedy = "rename the file or the camera, or say name=path"
        raise FormatError(source, "a camera name in UTF-8", name, remedy) from None
    return compose_name(name)
