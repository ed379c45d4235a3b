"""The journal: torn ends are survived, broken middles are not."""

import contextlib
import json
import math
import re
import subprocess
import sys
import time
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxscan.errors import CaptureError
from jaxscan.files.capture.journal import MAX_LINE_BYTES, parse_reference, read_journal


def read(data, kind="sweep", lasers=("red",)):
    return read_journal(data, name="frames.jsonl", kind=kind, laser_names=lasers)[:2]


def line(number, **keys):
    record = {"i": number, "angle_deg": float(number), "on": f"on/{number}.png", "off": f"off/{number}.png"}
    return json.dumps(record | keys).encode()


def refused(data, *patterns, kind="sweep"):
    with pytest.raises(CaptureError) as caught:
        read(data, kind)
    for pattern in patterns:
        assert pattern in str(caught.value)


def test_order_retakes_and_events():
    data = b"\n".join(
        [line(2), line(0), b'{"event": "fault"}', b"", line(1), line(0, angle_deg=90.0, new_key=[1]), b""]
    )
    records, notes = read(data)
    assert [record.i for record in records] == [0, 1, 2]
    assert records[0].angle == math.pi / 2
    assert notes == ()


@given(
    st.lists(st.tuples(st.integers(0, 6), st.floats(-720, 720)), min_size=1, max_size=6),
    st.text(max_size=5),
    st.booleans(),
    st.data(),
)
def test_any_truncation_of_the_last_line_keeps_all_earlier_records(entries, extra, unix, data):
    end = b"\n" if unix else b"\r\n"
    lines = [line(i, angle_deg=angle, note=extra) for i, angle in entries]
    whole = end.join(lines) + end
    start = len(whole) - len(lines[-1]) - len(end)
    cut = data.draw(st.integers(start, len(whole)))
    records, notes = read(whole[:cut])
    complete = cut >= start + len(lines[-1])
    expected = {i: math.radians(angle) for i, angle in (entries if complete else entries[:-1])}
    assert {record.i: record.angle for record in records} == expected
    assert [record.i for record in records] == sorted(expected)
    # Something was left out exactly if something of the line was there and not all of it.
    torn = start < cut < start + len(lines[-1])
    assert len(notes) == torn
    if torn:
        assert f"line {len(lines)}" in notes[0]


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data):
    try:
        read(data)
    except CaptureError as error:
        assert "frames.jsonl: line" in str(error)


@pytest.mark.parametrize("rubbish", [b"{", b"\x00" * 40, b"\xff\xfe", line(1)[:-3]])
def test_a_broken_line_is_dropped_at_the_end_and_refused_in_the_middle(rubbish):
    records, notes = read(line(0) + b"\n" + rubbish + b"\n")
    assert len(records) == 1 and "frames.jsonl: line 2" in notes[0]
    refused(line(0) + b"\n" + rubbish + b"\n" + line(2), "frames.jsonl: line 2", "repair or remove")


@pytest.mark.parametrize(
    ("data", "messages"),
    [
        (line(0, angle_deg=None), ["line 1: angle_deg: found null", "sweep needs the angle"]),
        (line(0, on=None), ["on: found null", "laser-on image"]),
        (line(0).replace(b"0.0", b"NaN"), ["angle_deg: found NaN, expected a finite number"]),
        (line(0, angle_deg="1"), ['angle_deg: found "1", expected a valid number']),
        (line(0, angle_deg=1e9), ["angle_deg: found 1000000000.0, expected less than"]),
        (line(0).replace(b'"i"', b'"j"'), ["line 1: i: missing, although angle_deg, off, on stand there"]),
        (line(0, angle_deg=True), ["angle_deg: found true, expected a valid number"]),
        (line(0, placement=2**31), ["placement: found 2147483648"]),
        (line(0, i=2**53), ["i: found 9007199254740992"]),
        (line(0, lasers=["red"] * 65), ["lasers: found", "at most 64 items"]),
        (line(0, on="../a.png"), ["line 1: on: ", "relative path inside the capture's folder"]),
        (line(0, off="a.npy"), ["line 1: off: ", "which image of the shard is meant"]),
        (b'{"i": 0, "x": ' + b"[" * 980 + b"]" * 980 + b"}", ["line 1: nested too deeply"]),
        (b'{"event": "x", "y": ' + b"[" * 64 + b"]" * 64 + b"}", ["line 1: nested too deeply"]),
        (b'{"i": 0, "x": ' + b"[" * 50_000 + b"]" * 5_000 + b"}", ["line 1"]),
        (b'{"i": 0, "x": "' + b"a" * MAX_LINE_BYTES + b'"}', ["line 1: longer than 64 KiB"]),
    ],
)
def test_lines_that_mean_no_record(data, messages):
    # In the middle, where nothing can be put down to a crash.
    refused(data + b"\n" + line(5), *messages)


def test_a_calibration_may_lack_what_a_sweep_needs():
    data = b'{"i": 0, "angle_deg": null, "off": "a.png"}\n{"i": 1, "on": "b.png", "placement": 4}'
    (first, second), _ = read(data, "calibration")
    assert (first.angle, first.on, first.lasers) == (None, (), ())
    assert ([str(one) for one in second.on], second.off, second.lasers, second.placement) == (["b.png"], (), (0,), 4)
    refused(b'{"i": 0, "angle_deg": 1.0}', "on, off: both are null", kind="calibration")


def test_events_may_have_any_keys():
    data = [b'{"event": "on", "on": true}', b'{"note": "by hand"}', b"{}", b'{"angle": 3}']
    records, notes = read(b"\n".join([*data, line(0)]))
    assert len(records) == 1 and notes == ()


def test_a_digest_of_an_image_that_is_absent_is_ignored():
    (record,) = read(line(0, off=None, sha256={"on": "a", "off": "b"}))[0]
    assert record.off == () and record.on[0].sha256 == "a"


def test_very_many_lines_are_refused_at_once():
    began = time.monotonic()
    for text in (b"\n", b"{}\n", b'{"i":1}\n'):
        refused(text * 2_000_001, "found 2000001 lines, expected at most 2000000")
    assert time.monotonic() - began < 10


@pytest.mark.more
@pytest.mark.parametrize("key", ["sha256", "lasers", "x", "time"])
def test_long_lines_take_little_memory(key):
    """Each holds 20,000 lists; together they would take a hundred times the size of the file."""
    text = b'{"i": %d, "angle_deg": 0.0, "on": "a.png", "' + key.encode() + b'": [' + b"[]," * 20_000 + b"0]}"
    data = b"\n".join(text % k for k in range(25))
    tracemalloc.start()
    try:
        with contextlib.suppress(CaptureError):
            read(data)
        assert tracemalloc.get_traced_memory()[1] < 3 * len(data)
    finally:
        tracemalloc.stop()


def test_takes_are_counted():
    data = b"\n".join([line(2), line(0), line(2), b'{"event": "end"}', line(2), b'{"i"'])
    assert read_journal(data, name="x", kind="sweep", laser_names=("red",)).takes == {2: 3, 0: 1}


@pytest.mark.parametrize(
    ("text", "path", "index"),
    [
        ("shards/on-1.npy#17", "shards/on-1.npy", 17),
        ("deep/er/a b.png", "deep/er/a b.png", None),
        ("a.png#1", "a.png#1", None),
    ],
)
def test_references(text, path, index):
    reference = parse_reference(text)
    assert (reference.path, reference.index, str(reference)) == (path, index, text)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("../secret.png", '".."'),
        ("on//000000.png", "empty part"),
        ("/etc/hostname", "not relative"),
        ("C:/secret.png", "not relative"),
        ("on\\000000.png", "backslash"),
        ("on/\x00.png", "control characters"),
        ("", "empty"),
        ("a" * 2000, "too long"),
        (7, "found 7, expected a path"),
        ("on/stack.npy", "which image of the shard"),
    ],
)
def test_references_that_are_refused(reference, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_reference(reference)


@pytest.mark.slow
def test_a_million_lines(tmp_path):
    """100,000 records, each taken ten times: measured 5 s of one core and 0.5 GB more than the imports take."""
    rows = [line(k, time="2026-11-22T08:00:00.000000Z", time_s=k + 0.123456, attempts=1) for k in range(100_000)]
    (tmp_path / "frames.jsonl").write_bytes(b"\n".join(rows * 10))
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom jaxscan.files.capture.journal import read_journal\n"
        # Not `ru_maxrss`, in which the memory of the parent counts too.
        "peak = lambda: int(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])\n"
        "before = peak(), time.process_time()\n"
        "data = Path(sys.argv[1]).read_bytes()\n"
        "journal = read_journal(data, name='x', kind='sweep', laser_names=('red',))\n"
        "taken = peak() - before[0] >> 10\n"
        "print(len(journal.records), sum(journal.takes.values()), taken, time.process_time() - before[1])"
    )
    path = str(tmp_path / "frames.jsonl")
    run = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    records, takes, megabytes, seconds = map(float, run.stdout.split())
    assert (records, takes) == (100_000, 1_000_000)
    assert megabytes < 800 and seconds < 30
