"""The journal: torn ends are survived, broken middles are not."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxscan.errors import CaptureError
from jaxscan.files.capture.journal import MAX_LINE_BYTES, read_journal


def read(data, kind="sweep", lasers=("red",)):
    return read_journal(data, name="frames.jsonl", kind=kind, laser_names=lasers)


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
        (b'{"i": 0, "on": "a.png"}', ["angle_deg: found null"]),
        (line(0, on=None), ["on: found null", "laser-on image"]),
        (line(0).replace(b"0.0", b"NaN"), ["angle_deg: found NaN, expected a finite number"]),
        (line(0).replace(b"0.0", b"1e999"), ["angle_deg: found Infinity, expected"]),
        (line(0, angle_deg="1"), ['angle_deg: found "1", expected a valid number']),
        (line(0, angle_deg=1e9), ["angle_deg: found 1000000000.0, expected less than"]),
        (line(0, i=-1), ["i: found -1, expected greater than or equal to 0"]),
        (line(0, i=1.5), ["i: found 1.5, expected a valid integer"]),
        (line(0, i=None), ["i: found null, expected a valid integer"]),
        (line(0, i=True), ["i: found true, expected a valid integer"]),
        (line(0, placement=-2), ["placement: found -2"]),
        (b"[1, 2]", ["line 1: found [1, 2], expected a JSON object"]),
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


def test_a_superseded_record_does_not_matter():
    records, _ = read(line(0, angle_deg=None) + b"\n" + line(0))
    assert records[0].angle == 0.0
