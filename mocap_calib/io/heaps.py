"""A look at the heaps of an HDF5 file, where its texts are, before HDF5 does: it reads a damaged one for ever.

The global heap ("HDF5 File Format Specification", III.E): a signature, a size, then objects with a number and a size; the object
0 is the free rest, whose size counts its own header. HDF5 steps from one to the next by these sizes, and a rest of size 0
does not let it get on.
"""

import io
import re
import struct

import h5py

_COLLECTION = re.compile(rb"GCOL\x01")  # and three bytes that HDF5 does not look at
_HEAD = 16  # bytes before the objects, and before each object's content
_NONE = 0xFFFFFFFF  # also the upper half of a small negative number, which is no length
_WORK = 2_000_000_000  # bytes looked at for references; a file with thousands of heaps is left to HDF5


def opened(content: bytes) -> h5py.File:
    """The file in memory. Raises what h5py raises on damage, and ValueError where HDF5 would not come back."""
    check_heaps(content)
    return h5py.File(io.BytesIO(content), "r")


def check_heaps(content: bytes) -> None:
    """Raises ValueError where an object of a heap goes beyond it, or is a rest too small to hold its own header.

    Also where a reference to an object (length, address of the heap, number) claims to be longer than the file: HDF5 takes
    that much memory before it looks.
    """
    heaps = list(_COLLECTION.finditer(content))
    for found in heaps:
        at = found.start() + _HEAD
        if at > len(content):
            raise ValueError("a heap that is cut")
        end = found.start() + struct.unpack_from("<Q", content, found.start() + 8)[0]
        if end > len(content):
            raise ValueError("a heap that is cut")
        while at + _HEAD <= end:
            number, size = struct.unpack_from("<H6xQ", content, at)
            step = size if number == 0 else _HEAD + (size + 7) // 8 * 8
            if step < _HEAD or at + step > end:
                raise ValueError("a damaged heap")
            at += step
    for found in heaps if len(heaps) * len(content) < _WORK else ():
        _check_references(content, struct.pack("<Q", found.start()))


def _check_references(content: bytes, address: bytes) -> None:
    at = content.find(address, 4)
    while 0 <= at <= len(content) - 12:
        length, number = struct.unpack_from("<I", content, at - 4)[0], struct.unpack_from("<I", content, at + 8)[0]
        if len(content) < length < _NONE and 0 < number < 65536:
            raise ValueError("a text that is longer than the file")
        at = content.find(address, at + 1)
