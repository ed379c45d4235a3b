"""The bench itself: the log of the simulated rig matches its actions."""

import json
import os
import time

import numpy as np
import pytest
import serial
from bench.camera.rendered import Exposure, LogReader, Plant
from bench.places import BenchError
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


def test_opening_the_port_resets_only_an_uno(rig):
    uno, other = rig(speed=0, autoreset=True), rig(speed=0)
    for simulated in (uno, other):
        for _ in range(2):
            with open_port(simulated):
                simulated.run_for(0.1)
            simulated.run_for(0.1)
    assert [edge["reset"] for edge in uno.edges() if "reset" in edge] == ["dtr", "dtr"]
    assert uno.plant()["resets"] == 2 and other.plant()["resets"] == 0
    assert [edge["host"] for edge in other.edges() if "host" in edge] == ["open", "closed"] * 2


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


def test_the_same_seed_breaks_the_same_bytes(rig):
    sent, backs = bytes(range(256)) * 4, []
    for seed in (5, 5, 6):
        simulated = rig(speed=0, firmware="echo", seed=seed)
        simulated.control("corrupt_rx 0.02")
        backs.append(echoed(simulated, sent))
        simulated.close()
    assert backs[0] == backs[1] != backs[2]


def test_at_another_baud_rate_nothing_sensible_arrives(rig):
    simulated = rig(speed=0, firmware="echo")
    assert echoed(simulated, b"hello") == b"hello"
    garbage = echoed(simulated, b"hello", baud=115_200)
    assert len(garbage) == 5 and not set(garbage) & set(b"hello")


def test_a_pulled_cable_ends_the_port_and_not_the_processor(rig):
    simulated = rig(speed=0)
    with open_port(simulated) as port:
        simulated.unplug()
        assert not os.path.lexists(simulated.port)
        with pytest.raises(OSError):
            while True:
                port.write(b"?")
                port.read(1)
    before = simulated.plant()["cycle"]
    simulated.run_for(0.1)
    assert simulated.plant()["resets"] == 0 and simulated.plant()["cycle"] > before
    simulated.plug()
    with connect(simulated.port) as controller:
        assert controller.hello().boot == 1


def test_a_laser_that_is_welded_or_dead(rig):
    simulated = rig(speed=0)

    def light():
        simulated.run_for(0.01)
        plant = simulated.plant()
        return plant["laser"], plant["light"]

    with ready(simulated) as controller:
        simulated.control("laser welded")
        assert light() == (0, 1)
        controller.arm(False)
        # The contactor is in series: nothing that happens to the MOSFET keeps it lit.
        assert light() == (0, 0)
        controller.arm(True)
        simulated.control("laser dead")
        simulated.control("speed 1")
        controller.laser(True, 900)
        assert light() == (1, 0)
        simulated.control("laser good")
        assert light() == (1, 1)
        controller.laser(False)
        assert light() == (0, 0)


def test_steps_faster_than_the_motor_can_are_lost(rig):
    simulated = rig(speed=0)
    with ready(simulated, speed=4000, start_speed=400) as controller:
        simulated.control("torque 2000")
        assert controller.move(4000) == 4000
    plant = simulated.plant()
    assert plant["lost_steps"] > 1000 and plant["pos"] == 4000 - plant["lost_steps"]


def test_commands_that_are_not_known_are_refused(rig):
    simulated = rig(speed=0)
    for text in ("dance", "dance 3", "corrupt_rx 1.5", "corrupt_up 0.1", "laser green", "speed -1", "pin Z9 1"):
        with pytest.raises(BenchError, match="does not know"):
            simulated.control(text)


def test_a_firmware_that_there_is_not(tmp_path):
    from bench import RigOptions, SimulatedRig

    with pytest.raises(BenchError, match=r"no firmware 'tea'.*scan, scan_hang, echo"):
        SimulatedRig(tmp_path, RigOptions(firmware="tea")).start()


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
