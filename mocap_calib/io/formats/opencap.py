"""OpenCap's cameraIntrinsicsExtrinsics.pickle: one camera, a dictionary of arrays.

The file's folder names the camera. `imageSize` is (height, width); rotation and translation lead
from the board to the camera, in millimetres; a file of intrinsics has none. Nothing is unpickled
but numpy's arrays.
"""

import io
import pickle
from typing import Any

from mocap_calib.io.cameras import CameraFile, RawCamera, collect_cameras, numbers
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format

_ALLOWED = {
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy.core.numeric", "_frombuffer"),
    ("numpy._core.numeric", "_frombuffer"),
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("_codecs", "encode"),
}
_KEYS = ("intrinsicMat", "distortion", "imageSize", "rotation", "translation")
_LARGEST = 100_000  # bytes; a camera has some hundreds


class _ArrayUnpickler(pickle.Unpickler):
    """Loads containers, text, numbers and numpy's arrays."""

    def find_class(self, module: str, name: str) -> Any:
        """Return what makes arrays. Raises UnpicklingError for anything else."""
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"a pickle that calls {module}.{name}")
        return super().find_class(module, name)


def sniff(document: Document) -> bool:
    """Return whether this is a small pickle with OpenCap's key."""
    return (
        not document.is_folder
        and document.start.startswith(b"\x80")
        and document.size < _LARGEST
        and _KEYS[0].encode() in document.start
    )


def read(document: Document) -> CameraFile:
    """Read the camera. Raises FormatError."""
    try:
        data = _ArrayUnpickler(io.BytesIO(document.content)).load()
    except Exception as error:  # a damaged pickle can raise anything
        raise document.refuse("a pickle of OpenCap", error) from None
    if not isinstance(data, dict) or not {*_KEYS[:3]} <= data.keys():
        raise document.refuse(", ".join(_KEYS[:3]), "another pickle")
    data = document.account.add(data)
    used = [key for key in _KEYS if data.get(key) is not None]
    arrays = {key: numbers(data[key], key, document.source) for key in used}
    raw = RawCamera(
        name=document.path.absolute().parent.name or document.stem,
        size=arrays["imageSize"].ravel()[1::-1],
        matrix=arrays["intrinsicMat"],
        distortion=arrays["distortion"],
        rotation=arrays.get("rotation"),
        translation=arrays.get("translation"),
    )
    return collect_cameras([raw], document.source)


FORMAT = Format(
    name="opencap",
    title="OpenCap camera .pickle",
    sniff=sniff,
    read=read,
    passed_over=("rotation_EulerAngles",),
    unit="mm",
)
