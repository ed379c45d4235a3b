"""Two lasers on the real firmware, from the pins' log: each shines alone, when asked to, and goes off on all paths."""

import json
import time

import numpy as np
import pytest
from scanrig.cameras.simulated import SimulatedCamera
from scanrig.controllers.jxs.controller import connect
from scanrig.controllers.jxs.protocol import ABORT, encode
from scanrig.errors import Refused
from scanrig.session import Devices, run_sweep

from .driving import falls, milliseconds, ready, rises
from .nursery import Wire, config, see


STEPS = 12
BOTH = [{"name": "left"}, {"name": "right"}]
PINS = ("light", "light_2")


def exposures(edges):
    """For each trigger pulse, which lasers shone while it was high."""
    shines, found = set(), []
    high = False
    for edge in edges:
        pin = edge.get("pin")
        if pin in PINS:
            (shines.add if edge["v"] else shines.discard)(PINS.index(pin) + 1)
        elif pin == "trig":
            high = bool(edge["v"])
            if high:
                found.append((edge["pos"], set()))
        if high:
            found[-1][1].update(shines)
    return found


def together(edges):
    """Whether two gates were ever high at once."""
    gates = {"laser": 0, "laser_2": 0}
    for edge in edges:
        if edge.get("pin") in gates:
            gates[edge["pin"]] = edge["v"]
            if all(gates.values()):
                return True
    return False


def test_a_sweep_lights_one_after_the_other(rig, tmp_path):
    simulated = rig(speed=0)
    settings = config(STEPS, laser=BOTH)
    generator = np.random.default_rng(3)
    camera = SimulatedCamera(settings.camera, lambda position, lit: see(position, lit, generator))
    wire = Wire(simulated.edges_path, camera)
    try:
        with connect(simulated.port) as controller:
            result = run_sweep(settings, tmp_path / "room", Devices(controller, camera))
            counters = controller.counters()
    finally:
        wire.close()
    assert (result.status, result.records, result.retakes) == ("complete", 2 * STEPS, 0)
    edges = simulated.edges()
    lit = exposures(edges)
    places = [8 * k for k in range(STEPS) for _ in range(4)] + [0, 0]
    assert lit == list(zip(places, [{1}, set(), {2}, set()] * STEPS + [{1}, set()], strict=True))
    assert not together(edges)
    # Once for each pair, and once more where the first step is compared in the end.
    assert len(rises(edges, "laser")) == STEPS + 1 and len(rises(edges, "laser_2")) == STEPS
    assert counters.laser_cycles == 2 * STEPS + 1
    plant = simulated.plant()
    assert (plant["laser"], plant["laser_2"], plant["contactor"]) == (0, 0, 0)
    records = [json.loads(line) for line in (tmp_path / "room" / "frames.jsonl").read_text().splitlines()]
    assert [one["lasers"] for one in records if "i" in one] == [["left"], ["right"]] * STEPS


def test_one_goes_off_before_the_other_comes_on(rig):
    simulated = rig()
    with ready(simulated, speed=1) as controller:
        for number in (1, 2, 1, 2):
            controller.laser(True, number=number)
        assert simulated.plant()["laser_2"] == 1
        controller.laser(False)
    edges = simulated.edges()
    assert not together(edges)
    assert len(rises(edges, "laser")) == len(rises(edges, "laser_2")) == 2


def dark(simulated, since, within_ms):
    """The second laser went off, and the contactor opened, so long after a cycle at most."""
    plant = simulated.plant()
    assert (plant["laser_2"], plant["light_2"], plant["contactor"]) == (0, 0, 0)
    took = milliseconds(since, falls(simulated.edges(), "laser_2")[-1])
    assert 0.0 <= took <= within_ms
    return took


@pytest.mark.parametrize("doing", ["lease", "shot"])
@pytest.mark.parametrize("event", ["estop", "abort", "hello"])
def test_what_puts_one_off_puts_the_other_off(rig, event, doing):
    simulated = rig()
    with ready(simulated, speed=1, laser_on_ms=5000) as controller:
        light(simulated, controller, doing)
        simulated.control("speed 0.05")
        since = simulated.plant()["cycle"]
        if event == "estop":
            simulated.control("estop 1")
        elif event == "abort":
            controller.link.write(ABORT)
        else:
            controller.link.write(encode(60001, "HELLO", ses=9))
        simulated.run_for(0.05)
        dark(simulated, since, 20.0)
        simulated.control("speed 0")


def test_its_lease_runs_out(rig):
    simulated = rig()
    with ready(simulated, speed=1) as controller:
        controller.laser(True, 200, number=2)
        end = time.monotonic() + 10.0
        while controller.stat().fault is None:
            assert time.monotonic() < end
        on = rises(simulated.edges(), "laser_2")[-1]
        assert 199.0 <= dark(simulated, on["cycle"], 201.0)


def test_the_watchdogs_reach_it(rig):
    simulated = rig(firmware="scan_hang")
    with ready(simulated, speed=0.2) as controller:
        controller.laser(True, 1000, number=2)
        hangs = simulated.plant()["cycle"]
        controller.link.write(encode(60000, "HANG", k=1))
        simulated.run_for(0.4)
        assert simulated.plant()["resets"] == 1
        dark(simulated, hangs, 270.0)
        simulated.control("speed 0")


def test_a_link_that_falls_silent_puts_it_off(rig):
    simulated = rig()
    with ready(simulated, speed=1, watchdog_ms=200) as controller:
        controller.laser(True, 1000, number=2)
        since = simulated.plant()["cycle"]
        simulated.run_for(0.4)
        dark(simulated, since, 210.0)


def test_it_needs_the_contactor_and_its_own_number(rig):
    simulated = rig()
    with ready(simulated, armed=False) as controller:
        with pytest.raises(Refused, match="not armed"):
            controller.laser(True, number=2)
        controller.arm(True)
        with pytest.raises(Refused, match="out of range"):
            controller.laser(True, number=3)
        assert controller.lasers() == 2
    assert rises(simulated.edges(), "laser_2") == []


def test_a_welded_mosfet_of_the_second_is_cut_by_the_contactor(rig):
    simulated = rig()
    with ready(simulated) as controller:
        simulated.control("laser_2 welded")
        assert simulated.plant()["light_2"] == 1
        controller.arm(False)
        assert simulated.plant()["light_2"] == 0


def light(simulated, controller, doing):
    """The second laser on, by hand or in a shot."""
    if doing == "shot":
        controller.shot(8, 1, number=2)
        end = time.monotonic() + 10.0
        while not simulated.plant()["light_2"]:
            assert time.monotonic() < end
            controller.poll()
    else:
        controller.laser(True, 1000, number=2)
    assert simulated.plant()["light_2"] == 1 and simulated.plant()["light"] == 0
