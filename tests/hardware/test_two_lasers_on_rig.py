"""Two lasers on the real firmware, from the pins' log: each shines alone. `test_laser_off` has when they go off."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scanrig.cameras.simulated import SimulatedCamera
from scanrig.controllers.jxs.controller import connect
from scanrig.errors import Refused
from scanrig.session import Devices, run_sweep

from .driving import ready, rises, together
from .scanning import Wire, config, see


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


def test_it_needs_the_contactor_and_its_own_number(rig):
    simulated = rig()
    with ready(simulated, armed=False) as controller:
        with pytest.raises(Refused, match="not armed"):
            controller.laser(True, number=2)
        controller.arm(True)
        with pytest.raises(Refused, match="out of range"):
            controller.laser(True, number=3)
        controller.configure(replace(controller.settings, lasers=2))  # Of the firmware, which says how many it has.
    assert rises(simulated.edges(), "laser_2") == []


def test_a_welded_mosfet_of_the_second_is_cut_by_the_contactor(rig):
    simulated = rig()
    with ready(simulated) as controller:
        simulated.control("laser_2 welded")
        assert simulated.plant()["light_2"] == 1
        controller.arm(False)
        assert simulated.plant()["light_2"] == 0
