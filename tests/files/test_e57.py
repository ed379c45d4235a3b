"""E57 as other programs write it, read bit by bit as libE57 reads it; and as those write it who mean ill."""

import time

import numpy as np
import pytest

from jaxscan.errors import CloudError
from jaxscan.files.clouds import load_cloud, save_cloud
from jaxscan.files.clouds.e57 import _unpacked, checksums

from .clouds import make_cloud
from .e57s import made, with_xml, xml_of
from .strangers import scaled, whole


pytest.importorskip("pye57", reason="the extra `export` is not installed")


def floats(single):
    return lambda e57, image: e57.FloatNode(image, 0.0, e57.E57_SINGLE if single else e57.E57_DOUBLE)


def test_checksums_are_those_of_the_standard():
    assert checksums(np.frombuffer(b"12345678", np.uint8)[None]).tolist() == [0x6087809A]


@pytest.mark.parametrize("bits", [1, 3, 7, 8, 9, 13, 16, 31, 32, 33, 57, 59, 63, 64])
def test_packed_bits(bits):
    values = np.random.default_rng(bits).integers(0, (1 << bits) - 1, 1001, np.uint64, endpoint=True)
    stream = sum(int(value) << (bits * k) for k, value in enumerate(values))
    data = bytearray(stream.to_bytes(-(-bits * 1001 // 8), "little"))
    assert np.array_equal(_unpacked(data, bits, 1001), values)


def test_packed_columns_are_read_as_libe57_packs_them(tmp_path):
    """Enough points for many packets, whose ends lie within a value."""
    rng, count = np.random.default_rng(1), 150_000
    steps = {axis: rng.integers(-40_000, 60_000, count, endpoint=True) for axis in "XYZ"}
    places = {axis: steps[axis] * 1e-4 + 2.0 for axis in "XYZ"}
    columns = [(f"cartesian{a}", scaled(-40_000, 60_000, 1e-4, 2.0), places[a].copy()) for a in "XYZ"]
    # The binding takes NumPy's int64 for 32 bits, not longlong.
    intensity = rng.integers(0, 2047, count, endpoint=True).astype(np.longlong)
    columns.append(("intensity", whole(0, 2047), intensity))
    rgb = rng.integers(0, 1023, (3, count), endpoint=True).astype(np.longlong)
    columns += [(f"color{c}", whole(0, 1023), rgb[k].copy()) for k, c in enumerate(("Red", "Green", "Blue"))]
    columns.append(("timeStamp", floats(False), rng.random(count)))
    columns.append(("returnCount", whole(5, 5), np.full(count, 5, np.longlong)))
    cloud = load_cloud(made(tmp_path / "a.e57", columns))
    np.testing.assert_allclose(cloud.xyz[0], np.stack([places[a] for a in "XYZ"], -1), rtol=0, atol=1e-12)
    assert np.array_equal(cloud.intensity[0], intensity)
    assert np.array_equal(cloud.rgb[0], np.round(rgb.T * (255 / 1023)))


@pytest.fixture
def good(tmp_path):
    save_cloud(make_cloud(), tmp_path / "good.e57")
    return (tmp_path / "good.e57").read_bytes()


def refused(path, data):
    path.write_bytes(data)
    begun = time.process_time()
    with pytest.raises(CloudError) as caught:
        load_cloud(path)
    # Nothing was unfolded: a thousand times less would do, and minutes were taken.
    assert time.process_time() - begun < 5 and "\n" not in str(caught.value)
    return str(caught.value)


LAUGHS = "".join(f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(9))


@pytest.mark.parametrize(
    ("before", "says"),
    [
        ('<!DOCTYPE e57Root SYSTEM "http://127.0.0.1:9/evil.dtd">', "holds definitions"),
        ('<!DOCTYPE e57Root [<!ENTITY s SYSTEM "file:///etc/hostname">]>', "holds definitions"),
        (f'<!DOCTYPE e57Root [<!ENTITY l0 "lol">{LAUGHS}]>', "holds definitions"),
        ("<!-- --><!DOCTYPE e57Root>", "holds definitions"),
        ("<!--<!DOCTYPE e57Root>-->", ""),
        ("<?xml-stylesheet href='http://127.0.0.1:9/a.xsl'?>", ""),
    ],
)
def test_definitions_are_refused_in_any_encoding(tmp_path, good, before, says):
    xml = xml_of(good).decode()
    head, _, rest = xml.partition("<e57Root")
    text = f"{head}{before}<e57Root{rest}"
    path = tmp_path / "a.e57"
    if not says:
        path.write_bytes(with_xml(good, text.encode()))
        assert load_cloud(path).valid.any()
        return
    assert says in refused(path, with_xml(good, text.encode()))
    assert "is not UTF-8" in refused(path, with_xml(good, text.encode("utf-16")))
    in_ebcdic = text.replace('encoding="UTF-8"', 'encoding="ebcdic-cp-us"').encode("cp037")
    assert "is not UTF-8" in refused(path, with_xml(good, in_ebcdic))
    for encoding in ("ebcdic-cp-us", "UTF-16", "ISO-8859-1", "UTF-7"):
        stated = xml.replace('encoding="UTF-8"', f'encoding="{encoding}"').encode()
        assert "expected UTF-8" in refused(path, with_xml(good, stated))


@pytest.mark.parametrize("place", [1020, 1021, 1022, 1023])
def test_xml_that_begins_within_a_checksum(tmp_path, good, place):
    """It begins with the next page: what is checked is what is parsed."""
    xml, path = xml_of(good), tmp_path / "a.e57"
    path.write_bytes(with_xml(good, xml, place=place))
    assert load_cloud(path).valid.any()
    hostile = xml.replace(b"<e57Root", b'<!DOCTYPE e57Root SYSTEM "http://127.0.0.1:9/a"><e57Root')
    assert "holds definitions" in refused(path, with_xml(good, hostile, place=place))
    # Without a declaration the document type stands where it was once overlooked.
    lone = hostile[hostile.index(b"<!DOCTYPE") :]
    assert "holds definitions" in refused(path, with_xml(good, lone, place=place))


def test_deep_long_and_many(tmp_path, good):
    xml = xml_of(good)
    path, end = tmp_path / "a.e57", b"</e57Root>"
    for more, says in (
        (b"<a>" * 200_000 + b"</a>" * 200_000, "more than 64 levels"),
        (b"<a/>" * 300_000, "more than 262144 elements"),
        (b"<a " + b"".join(b'a%d="" ' % k for k in range(10_000)) + b"/>", "more than 64 KiB"),
        (b"&nothing;", "damaged"),
        (b"<a>", "damaged"),
        (b"\0", "damaged"),
    ):
        assert says in refused(path, with_xml(good, xml.replace(end, more + end)))


def test_a_changed_byte_is_noticed(tmp_path, good):
    damaged = bytearray(good)
    damaged[100] ^= 1
    assert "the checksum of page 0" in refused(tmp_path / "a.e57", bytes(damaged))


def test_a_pose_that_is_no_rotation_is_refused(tmp_path):
    save_cloud(make_cloud(), tmp_path / "a.e57")
    data = (tmp_path / "a.e57").read_bytes()
    xml = xml_of(data)
    one = b'<w type="Float">1</w>'
    assert one in xml
    for length, fits in ((b"1.0004", True), (b"2", False), (b"0.5", False)):
        (tmp_path / "b.e57").write_bytes(with_xml(data, xml.replace(one, one.replace(b">1<", b">" + length + b"<"))))
        if fits:
            assert load_cloud(tmp_path / "b.e57").valid.any()
        else:
            with pytest.raises(CloudError, match="no rigid motion: its quaternion has the length"):
                load_cloud(tmp_path / "b.e57")
