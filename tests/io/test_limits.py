"""Small files that claim to hold more than memory does are one line, before it is taken."""

import io
import subprocess
import sys
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from platforms import linux
from scipy.io import savemat

import mocap_calib as mc

ZEROS = 3_000_000_000  # bytes


def npy_header(entries: int) -> bytes:
    content = io.BytesIO()
    described = {"descr": "<f8", "fortran_order": False, "shape": (entries,)}
    np.lib.format.write_array_header_1_0(content, described)
    return content.getvalue()


def deflated_zeros(head: bytes, entries: int, wbits: int) -> bytes:
    """Bytes and so many zeros, packed: 64 MB are packed once, and repeated."""
    block = 1 << 26
    packer = zlib.compressobj(9, zlib.DEFLATED, wbits)
    start = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    zeros = packer.compress(bytes(block)) + packer.flush(zlib.Z_FULL_FLUSH)
    return start + zeros * (entries // block) + packer.flush()


def npz_bomb() -> bytes:
    head = npy_header(ZEROS // 8)
    packed = deflated_zeros(head, ZEROS, -15)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        entry = zipfile.ZipInfo("positions.npy")
        entry.compress_type, entry.CRC, entry.header_offset = zipfile.ZIP_DEFLATED, 0, 0
        entry.compress_size, entry.file_size = len(packed), len(head) + ZEROS
        archive.fp.write(entry.FileHeader() + packed)
        archive.filelist.append(entry)
        archive.start_dir, archive._didModify = archive.fp.tell(), True
    return content.getvalue()


def test_an_npz_bomb_is_one_line_and_takes_no_memory(tmp_path):
    """3 MB that unpack to 3 GB: it took 3.3 GB and 20 s before."""
    path = tmp_path / "bomb.npz"
    path.write_bytes(npz_bomb())
    assert path.stat().st_size < 3_500_000
    mc.write  # noqa: B018 - the library is imported before memory is counted
    tracemalloc.start()
    with pytest.raises(mc.FormatError) as refused:
        mc.read_poses(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "at most 1000 MB of `positions.npy` in the 2.9 MB stored, found 3000 MB" in str(
        refused.value
    )
    assert "\n" not in str(refused.value)
    assert peak < 50_000_000


@pytest.mark.slow
@linux
def test_a_matlab_bomb_is_one_line(tmp_path):
    """A variable of 2 GB in 2 MB."""
    content = io.BytesIO()
    savemat(content, {"K": np.zeros((1, 1))}, do_compression=False)
    whole, size = content.getvalue(), 2_013_265_920
    at = whole.index((9).to_bytes(4, "little") + (8).to_bytes(4, "little"))  # 8 bytes of doubles
    inner = bytearray(whole[128:at] + (9).to_bytes(4, "little") + size.to_bytes(4, "little"))
    inner[4:8] = (len(inner) - 8 + size).to_bytes(4, "little")
    shape = inner.index((1).to_bytes(4, "little") * 2)
    inner[shape : shape + 8] = (1).to_bytes(4, "little") + (size // 8).to_bytes(4, "little")
    packed = deflated_zeros(bytes(inner), size, 15)
    path = tmp_path / "bomb.mat"
    path.write_bytes(
        whole[:128] + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed
    )
    with pytest.raises(mc.FormatError, match=r"fits into memory|Unable to allocate"):
        mc.read_cameras(path)


def test_scipy_is_imported_for_matlab_files_alone():
    program = (
        "import sys, mocap_calib as mc; mc.read_keypoints(sys.argv[1]); "
        "assert 'scipy.io' not in sys.modules"
    )
    example = Path(__file__).parents[2] / "examples/three_people/keypoints"
    subprocess.run([sys.executable, "-c", program, example], check=True)
