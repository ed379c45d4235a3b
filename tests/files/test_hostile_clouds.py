"""Clouds that are damaged, cut short, or made to do harm: a line that says so, and little memory."""

import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscan.errors import CloudError
from jaxscan.files.clouds import FORMATS, load_cloud, save_cloud
from jaxscan.files.clouds.pcd import unpack
from tests.fuzz.hardship import hardship

from .clouds import make_cloud, unsealed
from .test_cloud_exchange import needed


_good = {}


def good(suffix, folder):
    if suffix not in _good:
        needed(suffix)
        path = folder / f"good{suffix}"
        save_cloud(make_cloud(), path)
        _good[suffix] = unsealed(path)
    return _good[suffix]


@pytest.mark.parametrize("suffix", FORMATS)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_damage_is_read_or_refused(tmp_path_factory, suffix, data):
    """Cut anywhere and flip anything: a cloud comes back, or a typed error of one line."""
    whole = bytearray(good(suffix, tmp_path_factory.getbasetemp()))
    # Half of the flips hit the header.
    places = st.one_of(st.integers(0, len(whole) - 1), st.integers(0, min(600, len(whole)) - 1))
    for at in data.draw(st.lists(places, max_size=4)):
        whole[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(whole)))
    path = tmp_path_factory.getbasetemp() / f"damaged{suffix}"
    path.write_bytes(whole[:cut] if data.draw(st.booleans()) else whole)
    try:
        cloud = load_cloud(path)
    except CloudError as problem:
        assert "\n" not in str(problem) and len(str(problem)) < 300 + len(str(path))
        return
    assert cloud.valid.ndim == 2 and np.isfinite(cloud.xyz).all()


def refused(path, data):
    """The message with which a file is refused, and that it takes little memory."""
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(CloudError) as caught:
            load_cloud(path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # Imports of a library of a format count too.
    assert most < 64 << 20
    return str(caught.value)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("data", [b"", b"\n", b"x", b"\0" * 5000, b"1 2\n" * 9, b"x y z\n" * 20])
def test_files_of_something_else(tmp_path, suffix, data):
    needed(suffix)
    assert f"a{suffix}" in refused(tmp_path / f"a{suffix}", data)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"POINTS 30", b"POINTS 999999999999", "but the file ends before"),
        (b"FIELDS x", b"FIELDS q", "no x, y and z"),
        (b"SIZE 4 4", b"SIZE 4 3", "the header is wrong"),
        (b"COUNT 1 1 1 1 1 1", b"COUNT 1 1 1 1 1 999999", "more than 4096 numbers"),
        (b"COUNT 1 1 1 1 1 1", b"COUNT 1 1 1 1 1 99999999999999", "the header is wrong"),
        (b"DATA binary", b"DATA zipped", 'found the data "zipped"'),
        (b"WIDTH", b"WITDH", "which PCD does not know"),
        (b"# grid 6 5", b"# grid 6 99999999999", "more than the 268435456 cells"),
        (b"# jaxscan-cloud/1", b"# jaxscan-cloud/7", "a newer version of jaxscan reads it"),
        (b"DATA binary\n", b"DATA binary_compressed\n", "but the file ends before"),
    ],
)
def test_headers_of_pcd(tmp_path, old, new, says):
    data = good(".pcd", tmp_path)
    assert data.count(old) == 1
    assert says in refused(tmp_path / "a.pcd", data.replace(old, new))


def las_with(data, place, layout, *values):
    changed = bytearray(data)
    struct.pack_into(layout, changed, place, *values)
    return bytes(changed)


@pytest.mark.parametrize(
    ("place", "layout", "value", "says"),
    [
        (247, "<Q", 1 << 60, "announces"),
        (100, "<I", (1 << 32) - 1, "the header is longer than the file"),
        (247, "<Q", 0, "holds no points"),
        *((131, "<d", step, "not finite") for step in (float("nan"), float("inf"))),
        *((place, "<d", step, "mirror or squash") for place in (131, 147) for step in (-0.001, 0.0, 1e6, 1e300)),
    ],
)
def test_headers_of_las(tmp_path, place, layout, value, says):
    data = good(".las", tmp_path)
    assert says in refused(tmp_path / "a.las", las_with(data, place, layout, value))


def test_headers_of_laz(tmp_path):
    data = good(".laz", tmp_path)
    assert "expected at most 64 times the file" in refused(tmp_path / "a.laz", las_with(data, 247, "<Q", 1 << 30))
    (offset,) = struct.unpack_from("<I", data, 96)
    assert "not in the file" in refused(tmp_path / "b.laz", las_with(data, offset, "<q", 1 << 40))
    (table,) = struct.unpack_from("<q", data, offset)
    assert "parts of" in refused(tmp_path / "c.laz", las_with(data, table + 4, "<I", (1 << 32) - 1))


@pytest.mark.parametrize(("place", "value"), [(16, 1 << 60), (24, 1 << 60), (32, 1 << 60), (40, 1 << 20), (40, 0)])
def test_headers_of_e57(tmp_path, place, value):
    data = good(".e57", tmp_path)
    assert "announces more than the file holds" in refused(tmp_path / "a.e57", las_with(data, place, "<Q", value))


def test_blocks_of_ptx(tmp_path):
    data = good(".ptx", tmp_path)
    assert data.startswith(b"3\n5\n")
    for new, says in (
        (b"3\n999999999999\n", "but the file ends before"),
        (b"0\n5\n", "but the file ends before"),
        (b"-3\n5\n", "expected the numbers of columns and of rows"),
        (b"3\n4\n", "not a readable .ptx file"),
    ):
        assert says in refused(tmp_path / "a.ptx", data.replace(b"3\n5\n", new, 1))
    assert "no rigid motion" in refused(tmp_path / "a.ptx", data.replace(b"1 0 0 0\n", b"2 0 0 0\n"))
    assert "not finite" in refused(tmp_path / "a.ptx", data.replace(b"1 0 0 0\n", b"nan 0 0 0\n"))
    mirrored = refused(tmp_path / "a.ptx", data.replace(b"1 0 0 0\n", b"-1 0 0 0\n"))
    assert "the pose is no rigid motion: its axes are scaled by -1" in mirrored
    # A turn by 45 degrees that is written with five digits.
    turned = b"0.70711 0.70711 0 0\n-0.70711 0.70711 0 0\n"
    (tmp_path / "a.ptx").write_bytes(data.replace(b"1 0 0 0\n0 1 0 0\n", turned))
    np.testing.assert_allclose(np.linalg.det(load_cloud(tmp_path / "a.ptx").stations.pose[0]), 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 2 3\n4 5\n", "not a readable .xyz file"),
        ("1 2 3\n4 5 six\n", "not a readable .xyz file"),
        ("nan nan nan\n", "holds no finite point"),
        ("1e30 0 0\n0 0 0\n", "expected at most 1e+15"),
        ("1 2\n", "found 2 numbers a line, expected x, y and z at least"),
    ],
)
def test_text_that_is_no_cloud(tmp_path, text, says):
    assert says in refused(tmp_path / "a.xyz", text.encode())


@pytest.mark.parametrize("kind", ["ascii", "binary_compressed"])
def test_pcd_of_other_programs(tmp_path, kind):
    """As PCL writes it: colours packed in a float, padding, a field of several numbers."""
    xyz = np.array([[1, 2, 3], [4, 5, 6], [np.nan, 0, 0]], np.float32)
    colour = np.array([0x0A141E, 0x28323C, 0], np.uint32).view(np.float32)
    head = "VERSION .7\nFIELDS x y z rgb _ fpfh\nSIZE 4 4 4 4 1 4\nTYPE F F F F U F\nCOUNT 1 1 1 1 2 3\n"
    head += "WIDTH 3\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA {kind}\n"
    if kind == "ascii":
        rows = [f"{x} {y} {z} {float(c)!r} 0 0 7 8 9" for (x, y, z), c in zip(xyz, colour, strict=True)]
        data = "\n".join(rows).encode() + b"\n"
    else:
        flat = b"".join(xyz[:, k].tobytes() for k in range(3)) + colour.tobytes() + bytes(6) + bytes(36)
        # Bytes as they are, 32 at a time, then one repetition of the last zero.
        plain = flat[:53]
        packed = b"".join(bytes([len(part) - 1]) + part for part in (plain[:32], plain[32:]))
        rest = len(flat) - 53
        packed += bytes([7 << 5, rest - 9, 0])
        data = struct.pack("<II", len(packed), len(flat)) + packed
    (tmp_path / "a.pcd").write_bytes(head.encode() + data)
    cloud = load_cloud(tmp_path / "a.pcd")
    assert cloud.xyz.tolist() == [[[1, 2, 3], [4, 5, 6]]]
    assert cloud.rgb.tolist() == [[[10, 20, 30], [40, 50, 60]]]


def test_lzf():
    assert unpack(b"\x02abc", 3) == b"abc"
    assert unpack(b"\x02abc\x20\x02", 6) == b"abcabc"
    assert unpack(b"\x00a\xe0\x00\x00", 10) == b"a" * 10
    for packed, size in (
        (b"\x02ab", 3),
        (b"\x20\x05", 3),
        (b"\x00a", 2),
        (b"\x00a\xe0", 9),
        (b"\x00a\xe0\xff\x00", 10),
    ):
        with pytest.raises(ValueError):
            unpack(packed, size)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, suffix):
    """Libraries that pack points have errors of their own for it."""
    needed(suffix)
    path = tmp_path / f"cloud{suffix}"
    save_cloud(make_cloud(), path)
    size = path.stat().st_size
    path.unlink()
    with pytest.raises(CloudError, match="cannot be written") as problem, hardship(size // 2, ()):
        save_cloud(make_cloud(), path)
    assert "\n" not in str(problem.value)
    assert list(tmp_path.iterdir()) == []
