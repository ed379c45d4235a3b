"""NPZ files of any origin: what they ask for is bounded before memory is taken."""

import io
import struct
import time
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest

from jaxscan.errors import CloudError
from jaxscan.files.disk import read_arrays, write_arrays


def npy(array):
    text = io.BytesIO()
    np.lib.format.write_array(text, np.asarray(array))
    return text.getvalue()


def announced(descr, shape):
    text = io.BytesIO()
    np.lib.format.write_array_header_1_0(text, {"descr": descr, "fortran_order": False, "shape": shape})
    return text.getvalue()


def archive(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as made:
        for name, content in members:
            made.writestr(name, content)


def refused(path, match, **how):
    """Refused in one line, at once, and with little memory."""
    tracemalloc.start()
    began = time.monotonic()
    try:
        with pytest.raises(CloudError, match=match) as caught:
            read_arrays(path, error=CloudError, **how)
        taken = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500
    # The list of members may take some; the file of this test that takes most has 4 MiB of them.
    assert taken < 200e6 and time.monotonic() - began < 30


def test_read_as_written(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "t": np.array("text"), "e": np.zeros((0, 4), np.uint8)}
    write_arrays(tmp_path / "a.npz", arrays)
    for how in ({}, {"stored": True}, {"links": "refuse"}):
        found = read_arrays(tmp_path / "a.npz", error=CloudError, **how)
        assert found.keys() == arrays.keys()
        assert all(np.array_equal(found[name], arrays[name]) for name in arrays)
    assert read_arrays(tmp_path / "a.npz", error=CloudError, only="t").keys() == {"t"}
    np.savez_compressed(tmp_path / "b.npz", **arrays)
    assert read_arrays(tmp_path / "b.npz", error=CloudError).keys() == arrays.keys()
    refused(tmp_path / "b.npz", "found compressed arrays", stored=True)


@pytest.mark.parametrize("descr", ["|S0", "<U0", "|V0", "|O", "|V8", "<M8[s]"])
def test_types_without_size_or_meaning(tmp_path, descr):
    archive(tmp_path / "a.npz", [("a.npy", announced(descr, (10**15,)))])
    refused(tmp_path / "a.npz", "it announces")


@pytest.mark.parametrize("shape", [(10**15,), (0, 10**18), (1,) * 70, (2**62, 2**62), (-1,)])
def test_shapes_that_no_file_holds(tmp_path, shape):
    archive(tmp_path / "a.npz", [("a.npy", announced("<f8", shape))])
    refused(tmp_path / "a.npz", "not a readable .npz file")


def test_all_arrays_together_are_bounded(tmp_path):
    """Each is within the bound of one; a thousand of them would take 16 GB."""
    content = npy(np.zeros(1 << 24, np.uint8))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
        for k in range(4):
            made.writestr(f"{k}.npy", content)
    refused(tmp_path / "a.npz", r"its arrays would take 67109376 bytes of memory, expected at most")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as made:
        for k in range(4):
            made.writestr(f"{k}.npy", content)
    refused(tmp_path / "a.npz", "expected at most 60000000", limit=60_000_000)
    assert len(read_arrays(tmp_path / "a.npz", error=CloudError)) == 4


def test_members_that_lie_over_one_another(tmp_path):
    """Many entries of the list name the same bytes of the file."""
    archive(tmp_path / "a.npz", [("0.npy", npy(np.zeros(1 << 20, np.uint8)))])
    data = (tmp_path / "a.npz").read_bytes()
    start = data.index(b"PK\x01\x02")
    entry, end = data[start : data.index(b"PK\x05\x06")], data.index(b"PK\x05\x06")
    names = [f"{k:x}.npy".encode() for k in range(16)]
    listed = b"".join(entry.replace(b"0.npy", name) for name in names)
    tail = bytearray(data[end:])
    struct.pack_into("<HHL", tail, 8, len(names), len(names), len(listed))
    # Repeated until they are more than the ratio allows.
    (tmp_path / "a.npz").write_bytes(data[:start] + listed + bytes(tail))
    with zipfile.ZipFile(tmp_path / "a.npz") as made:
        assert sum(one.file_size for one in made.infolist()) > 16 << 20
    refused(tmp_path / "a.npz", "would take", stored=True)


def test_a_name_twice(tmp_path):
    for names in (("a.npy", "a.npy"), ("a", "a.npy")):
        with warnings.catch_warnings(action="ignore"):
            archive(tmp_path / "a.npz", [(name, npy(k)) for k, name in enumerate(names)])
        refused(tmp_path / "a.npz", "found 2 arrays of 1 names, expected each name once")


def test_a_list_of_very_many_members(tmp_path):
    entry = struct.pack("<4s4B4HL2L5H2L", b"PK\x01\x02", *[0] * 18)
    assert len(entry) == 46
    for count, match in ((20_000, "arrays of 1 names"), (700_000, "its list of arrays takes 32200000 bytes")):
        listed = entry * count
        end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 65535, 65535, len(listed), 0, 0)
        (tmp_path / "a.npz").write_bytes(listed + end)
        refused(tmp_path / "a.npz", match)


def test_an_encrypted_member(tmp_path):
    archive(tmp_path / "a.npz", [("a.npy", npy(0))])
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[6] |= 1
    data[data.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "a.npz").write_bytes(bytes(data))
    refused(tmp_path / "a.npz", "encrypted")


def test_a_header_without_end(tmp_path):
    """The header of an array may say that it is 4 GB long."""
    content = b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1) + b" " * (1 << 20)
    archive(tmp_path / "a.npz", [("a.npy", content)], zipfile.ZIP_DEFLATED)
    refused(tmp_path / "a.npz", "not a readable .npz file")
