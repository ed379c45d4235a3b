"""The bench itself: the log of the simulated rig matches its actions."""

import json
import time

import numpy as np
import pytest
import serial
from bench.camera.rendered import Exposure, LogReader, Plant
from bench.rig import CLOCK_HZ
from scanrig.controllers.jxs.controller import connect

from .driving import ready


def pulses(edges, pin):
    """(rise, fall) of every pulse of a pin [cycles]."""
    at = [(edge["cycle"], edge["v"]) for edge in edges if edge.get("pin") == pin]
    rises = [cycle for cycle, level in at if level]
    falls = [cycle for cycle, level in at if not level and cycle > 0]
    return list(zip(rises, falls, strict=True))


def open_port(simulated, baud=250_000):
    return serial.Serial(simulated.port, baud, timeout=2.0)


def echoed(simulated, data, *, baud=250_000):
    """The bytes that an echoing device returns for `data`."""
    before = simulated.plant()["received"]
    with open_port(simulated, baud) as port:
        back = b""
        for start in range(0, len(data), 500):
            port.write(data[start : start + 500])
            limit = time.monotonic() + 20
            while simulated.plant()["received"] < before + min(start + 500, len(data)):
                assert time.monotonic() < limit
            back += port.read(port.in_waiting)
        simulated.run_for(0.005)
        # Bytes written at one end of a pseudo-terminal arrive at the other with a delay.
        port.timeout = 0.3
        while more := port.read(max(port.in_waiting, 1)):
            back += more
    return back


def test_simulated_time_keeps_step_with_the_clock(rig):
    simulated = rig(speed=1.0)
    began, first = time.monotonic(), simulated.plant()["cycle"]
    time.sleep(0.4)
    last, ended = simulated.plant()["cycle"], time.monotonic()
    passed = (last - first) / CLOCK_HZ
    # It waits for the clock, so it is never early by more than its 0.5 ms quantum and the two answers; on a machine
    # that is busy elsewhere it may be late.
    assert 0.1 < passed < (ended - began) + 0.02


def test_shots_on_the_pins(rig):
    steps, each = 20, 80
    simulated = rig(speed=0)
    times = {"settle_ms": 10, "laser_on_ms": 7, "laser_off_ms": 9, "exposure_ms": 5, "gap_ms": 3}
    with ready(simulated, **times) as controller:
        for k in range(1, steps + 1):
            controller.shot(k * each, k)
            controller.wait_shot(k)
    edges = simulated.edges()
    assert simulated.plant()["pos"] == steps * each
    triggers, lights = pulses(edges, "trig"), pulses(edges, "light")
    assert len(triggers) == 2 * steps and len(lights) == steps
    assert lights == pulses(edges, "laser")
    # The firmware counts milliseconds; an interrupt that holds its clock up shifts an edge by some microseconds.
    slack, ms = CLOCK_HZ // 20_000, CLOCK_HZ // 1000
    for (rise, fall), (dark_rise, dark_fall), (on, off) in zip(triggers[::2], triggers[1::2], lights, strict=True):
        assert [fall - rise, dark_fall - dark_rise] == pytest.approx([5 * ms] * 2, abs=slack)
        assert on < rise < fall < off < dark_rise
        assert [rise - on, off - fall, dark_rise - off] == pytest.approx([7 * ms, 3 * ms, 9 * ms], abs=slack)
    stepped = np.array([edge["cycle"] for edge in edges if edge.get("pin") == "step" and edge["v"]])
    for rise, fall in triggers:
        assert not np.any((stepped > rise) & (stepped < fall))
    where = [edge["pos"] for edge in edges if edge.get("pin") == "trig" and edge["v"]]
    assert where == [k * each for k in range(1, steps + 1) for _ in range(2)]


def test_stamps_and_positions_go_on_over_resets_and_power_cuts(rig):
    simulated = rig(speed=0)
    with ready(simulated) as controller:
        controller.move(300)
        boot = controller.hello().boot
    simulated.control("reset")
    simulated.run_for(0.05)
    simulated.restart()
    with connect(simulated.port) as controller:
        assert controller.hello().boot == boot + 2
    assert simulated.plant()["pos"] == 300
    edges = simulated.edges()
    assert all(np.diff([edge["cycle"] for edge in edges]) >= 0)
    reset = next(index for index, edge in enumerate(edges) if edge.get("reset") == "button")
    after = {edge["pin"]: edge["v"] for edge in edges[reset : reset + 6] if "pin" in edge}
    # In reset nothing drives the pins: the driver's pull-up disables it.
    assert after["en_n"] == 1


def test_noise_is_as_much_as_configured(rig):
    sent, share = bytes(range(256)) * 16, 0.05
    counts = {}
    for fault in ("corrupt_rx", "corrupt_tx", "drop_rx", "drop_tx", "duplicate_rx", "duplicate_tx"):
        simulated = rig(speed=0, firmware="echo")
        simulated.control(f"{fault} {share}")
        back = echoed(simulated, sent)
        counts[fault] = abs(len(back) - len(sent)) or sum(a != b for a, b in zip(back, sent, strict=True))
        simulated.close()
    # A binomial count; five standard deviations, so that no seed fails.
    spread = 5 * np.sqrt(len(sent) * share * (1 - share))
    assert list(counts.values()) == pytest.approx([len(sent) * share] * 6, abs=spread), counts


def log(*entries):
    """Lines of a log: (cycle, pin, level, position)."""
    return [{"cycle": cycle, "pin": pin, "v": level, "pos": pos} for cycle, pin, level, pos in entries]


def exposures(lines, turn=1000):
    plant = Plant(turn)
    return [ended for line in lines if (ended := plant.read(line)[1]) is not None]


def test_an_exposure_has_the_light_during_its_pulse():
    lit = log((0, "light", 1, 7), (100, "trig", 1, 7), (300, "trig", 0, 7), (400, "light", 0, 7))
    half = log((500, "trig", 1, 8), (600, "light", 1, 8), (700, "trig", 0, 8), (800, "light", 0, 8))
    twice = log((900, "trig", 1, 9), (910, "light", 1, 9), (920, "light", 0, 9), (930, "light", 1, 9))
    twice += log((940, "light", 0, 9), (1000, "trig", 0, 9))
    dark = log((1100, "trig", 1, 9), (1200, "trig", 0, 9))
    assert exposures(lit + half + twice + dark) == [
        Exposure(100, 7, 1.0),
        Exposure(500, 8, 0.5),
        Exposure(900, 9, 0.2),
        Exposure(1100, 9, 0.0),
    ]


def test_home_is_where_the_switch_closed_on_the_way_down():
    down = log((0, "dir", 1, 1500), (1, "home_n", 1, 1500), (2, "home_n", 0, 1000))
    up = log((3, "dir", 0, 1000), (4, "home_n", 1, 1001), (5, "home_n", 0, 1961))
    shot = log((6, "trig", 1, 1990), (7, "trig", 0, 1990))
    assert exposures(down + up + shot) == [Exposure(6, 990, 0.0)]


def test_half_a_line_is_read_when_it_is_whole(tmp_path):
    path = tmp_path / "edges.jsonl"
    reader = LogReader(path)
    assert reader.lines() == []
    first, second = (json.dumps({"cycle": n}) + "\n" for n in (1, 2))
    path.write_text(first + second[:5])
    assert reader.lines() == [{"cycle": 1}]
    # Cut back to the last whole line, as a rig does that was killed within one.
    path.write_text(first)
    assert reader.lines() == []
    path.write_text(first + second)
    assert reader.lines() == [{"cycle": 2}]
