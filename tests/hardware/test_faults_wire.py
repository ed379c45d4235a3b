"""Faults between host and controller, on the real firmware: judged by the table and the pins."""

import contextlib
import random
import time
from dataclasses import replace

import pytest
from scanrig.clock import Clock
from scanrig.controllers.controller import Settings
from scanrig.controllers.jxs.controller import connect
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.controllers.jxs.protocol import encode, seal
from scanrig.errors import ControllerReset, LinkLost, Refused, RigFault
from scanrig.wire import open_serial

from .driving import PATIENT, falls, make_ready, milliseconds, ready, rises


SHORT = {"settle_ms": 5, "laser_on_ms": 5, "laser_off_ms": 5, "exposure_ms": 2, "gap_ms": 1}
"""Short shots: these tests do not depend on their duration."""


def noise(rig, **probabilities):
    for name, probability in probabilities.items():
        rig.control(f"{name} {probability}")


def shoot(controller, shots):
    for number in range(1, shots + 1):
        controller.shot(8 * number, number)
        done = controller.wait_shot(number)
        assert done.position == 8 * number


def assert_done_once(rig, shots):
    """As many pulses and triggers as were commanded, each where it belongs."""
    edges = rig.edges()
    assert len(rises(edges, "laser")) == shots
    triggers = rises(edges, "trig")
    assert [edge["pos"] for edge in triggers] == [8 * (n // 2 + 1) for n in range(2 * shots)]
    assert rig.plant()["pos"] == 8 * shots


# 1: bit errors, lost and doubled bytes


@pytest.mark.parametrize(
    "damage",
    [
        {"corrupt_rx": 0.005, "corrupt_tx": 0.005, "drop_rx": 0.002, "drop_tx": 0.002},
        pytest.param({"duplicate_rx": 0.005, "duplicate_tx": 0.005}, marks=pytest.mark.slow),
    ],
    ids=["flipped and lost", "doubled"],
)
def test_bit_errors_lost_and_doubled_bytes_do_nothing_twice(rig, damage):
    simulated = rig()
    with ready(simulated, **SHORT) as controller:
        noise(simulated, **damage)
        shoot(controller, 150)
        noise(simulated, **dict.fromkeys(damage, 0))
        assert_done_once(simulated, 150)
        counts = controller.link_counts
        assert counts.resent > 10 and counts.naks > 5 and counts.damaged > 10
        assert controller.counters().laser_cycles == 150
        print(counts)


def test_lost_replies_and_events_are_asked_for_again(rig):
    simulated = rig()
    with ready(simulated, **SHORT) as controller:
        noise(simulated, drop_tx=0.006)
        shoot(controller, 40)
        noise(simulated, drop_tx=0)
        assert_done_once(simulated, 40)
        assert controller.link_counts.events_missed > 3
        assert controller.counters().repeated > 3


# 2: replies and events that are lost


# 3: more than the controller's buffer holds


def test_a_host_that_does_not_wait_breaks_nothing(rig):
    simulated = rig()
    with ready(simulated, speed=10, **SHORT) as controller:
        boot = controller.hello().boot
        controller.arm(True)
        link = controller.link
        for start in range(0, 400, 100):
            link.write(b"".join(encode(20000 + start + n, "STAT") for n in range(100)))
            simulated.run_for(0.05)
        simulated.run_for(1.0)
        shoot(controller, 3)
        counters = controller.counters()
        assert counters.overruns > 0 and counters.damaged > 0
        assert controller.hello().boot == boot
        assert_done_once(simulated, 3)


@pytest.mark.parametrize("length", [97, 5000])
def test_over_long_lines_are_never_carried_out(rig, length):
    simulated = rig()
    with ready(simulated, **SHORT) as controller:
        text = "@20000 LASER on=1 ms=500"
        controller.link.write(seal(text.ljust(length - 5)))
        controller.link.write(seal("@20001 LASER on=1 ms=500".replace("=1", "=" + "0" * (length - 30) + "1")))
        assert not controller.stat().laser
        assert controller.link_counts.naks >= 1
        shoot(controller, 2)
        assert_done_once(simulated, 2)


@pytest.mark.slow
def test_a_cable_pulled_in_a_slow_move_leaves_the_position_good(rig):
    simulated = rig()
    with ready(simulated, speed=1, watchdog_ms=500, **SHORT) as controller:
        controller.configure(slow(controller))
        controller.shot(800, 1)
        simulated.run_for(0.2)
        simulated.unplug()
        with pytest.raises(LinkLost):
            controller.wait_shot(1)
        simulated.run_for(1.0)
        stopped = simulated.plant()
        assert 0 < stopped["pos"] < 800
        simulated.plug()
        found = controller.reconnect(timeout_s=10.0)
        assert (found.same_boot, not found.status.homed) == (True, False)
        assert found.status.position == simulated.plant()["pos"] == stopped["pos"]
        controller.arm(True)
        controller.shot(800, 1)
        assert controller.wait_shot(1).position == simulated.plant()["pos"] == 800
        assert [edge["pos"] for edge in rises(simulated.edges(), "trig")] == [800, 800]


# 6: the cable


def test_a_cable_pulled_for_a_moment_in_a_move(rig):
    simulated = rig()
    with ready(simulated, speed=1, **SHORT) as controller:
        controller.shot(20000, 1)
        simulated.run_for(0.4)
        simulated.unplug()
        with pytest.raises(LinkLost):
            controller.wait_shot(1)
        simulated.plug()
        found = controller.reconnect(timeout_s=10.0)
        assert (found.same_boot, not found.status.homed, found.status.state) == (True, False, "idle")
        assert found.status.position == simulated.plant()["pos"] < 20000
        assert rises(simulated.edges(), "trig") == []
        controller.arm(True)
        controller.shot(800, 1)
        assert controller.wait_shot(1).position == simulated.plant()["pos"] == 800


@pytest.mark.slow
def test_a_cable_pulled_in_a_fast_move_asks_for_home(rig):
    simulated = rig()
    with ready(simulated, speed=1, watchdog_ms=500, **SHORT) as controller:
        controller.shot(20000, 1)
        simulated.run_for(0.5)
        simulated.unplug()
        with pytest.raises(LinkLost):
            controller.wait_shot(1)
        simulated.run_for(1.0)
        edges = simulated.edges()
        unplugged = next(edge for edge in edges if edge.get("line") == "unplugged")
        assert milliseconds(unplugged, rises(edges, "step")[-1]) < 520.0
        simulated.plug()
        found = controller.reconnect(timeout_s=10.0)
        assert (found.same_boot, not found.status.homed) == (True, True)
        assert found.status.position == simulated.plant()["pos"]
        assert make_ready(controller) == 0
        assert simulated.plant()["pos"] == 0


@pytest.mark.slow
def test_power_lost_in_a_shot_asks_for_home(rig):
    simulated = rig()
    with ready(simulated, speed=1, **SHORT) as controller:
        controller.shot(4000, 1)
        simulated.run_for(0.3)
        simulated.kill()
        with pytest.raises(LinkLost):
            controller.wait_shot(1)
        simulated.start()
        found = controller.reconnect(timeout_s=10.0)
        assert (found.same_boot, not found.status.homed) == (False, True)
        make_ready(controller)
        assert simulated.plant()["pos"] == 0
        controller.shot(800, 1)
        controller.wait_shot(1)
        assert simulated.plant()["pos"] == 800


def test_opening_the_port_resets_an_uno(rig):
    simulated = rig(autoreset=True)
    with ready(simulated, speed=1, **SHORT) as controller:
        first = controller.hello().boot
        assert controller.stat().homed
    simulated.run_for(0.05)  # The simulated board must see that nobody is there before somebody is again.
    again = connect(simulated.port)
    assert again.hello().boot == first + 1
    assert not again.stat().homed
    again.close()


# 7: resets


def test_a_reset_in_a_shot_is_noticed_and_recovered_from(rig):
    simulated = rig()
    with ready(simulated, speed=1, laser_on_ms=300) as controller:
        controller.shot(80, 1)
        wait_for_light(simulated)
        simulated.control("reset")
        with pytest.raises(ControllerReset, match="position and settings are gone"):
            controller.wait_shot(1)
        reset = next(edge for edge in simulated.edges() if edge.get("reset") == "button")
        assert milliseconds(reset, falls(simulated.edges(), "laser")[-1]) <= 0.1
        with pytest.raises(ControllerReset):
            controller.move(0)
        found = controller.reconnect()
        assert (found.same_boot, not found.status.homed) == (False, True)
        simulated.control("speed 0")
        make_ready(controller)
        controller.shot(80, 1)
        assert controller.wait_shot(1).position == simulated.plant()["pos"] == 80


def test_a_reset_whose_event_is_lost_moves_nothing(rig):
    simulated = rig()
    with ready(simulated, speed=1, **SHORT) as controller:
        noise(simulated, drop_tx=1)
        simulated.control("reset")
        simulated.run_for(0.1)
        noise(simulated, drop_tx=0)
        steps = simulated.plant()["steps"]
        with pytest.raises(ControllerReset):
            controller.shot(800, 1)
        assert simulated.plant()["steps"] == steps


@pytest.mark.parametrize("kind", [pytest.param(0, marks=pytest.mark.slow), 1], ids=["main loop", "interrupts off"])
def test_a_hang_ends_in_a_reset_that_is_noticed(rig, kind):
    simulated = rig(firmware="scan_hang")
    with ready(simulated, speed=1, **SHORT) as controller:
        controller.link.write(encode(60000, "HANG", k=kind))
        simulated.run_for(0.5)
        with pytest.raises(ControllerReset):
            controller.stat()
        assert not controller.reconnect().status.homed
        assert controller.counters().watchdog_resets == 1


# 11: e-stop


def test_the_emergency_stop_latches(rig):
    simulated = rig()
    with ready(simulated, speed=1, **SHORT) as controller:
        controller.shot(20000, 1)
        simulated.run_for(0.4)
        simulated.control("estop 1")
        with pytest.raises(RigFault, match="emergency stop") as fault:
            controller.wait_shot(1)
        edges = simulated.edges()
        pressed = rises(edges, "estop")[-1]
        assert [edge for edge in rises(edges, "step") if edge["cycle"] > pressed["cycle"] + 1600] == []
        assert fault.value.position == simulated.plant()["pos"]
        plant = simulated.plant()
        assert (plant["enabled"], plant["contactor"], plant["laser"]) == (0, 0, 0)
        with pytest.raises(Refused, match="still pressed"):
            controller.clear()
        simulated.control("estop 0")
        simulated.run_for(0.2)
        with pytest.raises(RigFault):
            controller.move(0)
        controller.clear()
        status = controller.stat()
        assert not status.homed and not status.armed and not status.enabled
        with pytest.raises(Refused, match="driver is off"):
            controller.shot(0, 2)
        assert simulated.plant()["steps"] == plant["steps"]
        simulated.control("speed 0")
        make_ready(controller)
        assert simulated.plant()["pos"] == 0


def test_an_emergency_stop_pressed_at_power_up(rig):
    simulated = rig(speed=1)
    simulated.control("estop 1")
    simulated.control("reset")
    controller = connect(simulated.port)
    controller.hello()
    with pytest.raises(RigFault, match="emergency stop"):
        controller.enable(True)
    assert simulated.plant()["enabled"] == 0
    controller.close()


# 12: the home switch


@pytest.mark.parametrize("level", [1, 0], ids=["missing", "stuck"])
def test_a_home_switch_that_is_missing_or_stuck_ends_the_search(rig, level):
    simulated = rig(speed=0)
    simulated.control(f"home {level}")
    controller = connect(simulated.port)
    controller.hello()
    controller.configure(Settings(watchdog_ms=PATIENT))
    controller.enable(True)
    with pytest.raises(RigFault, match="home switch not found, or stuck"):
        controller.home(3000)
    steps = simulated.plant()["steps"]
    assert 0 < steps <= 3000 + 1100  # the allowed distance, and the ramp down
    simulated.run_for(0.5)
    assert simulated.plant()["steps"] == steps
    simulated.control("home -1")
    controller.clear()
    controller.home(40000)
    assert simulated.plant()["pos"] % 28800 == 0
    controller.close()


def test_a_home_switch_that_bounces_is_found_at_one_place(rig):
    simulated = rig(bounce_us=2000)
    with ready(simulated, **SHORT) as controller:
        for start in (0, 333, 5000):
            controller.move(start)
            assert abs(controller.home(40000)) <= 1
            assert abs(simulated.plant()["pos"]) <= 1


def test_home_from_within_the_switch(rig):
    simulated = rig(start=-20)
    with ready(simulated, **SHORT) as controller:
        assert simulated.plant()["pos"] == 0
        assert controller.stat().position == 0


# 13: lost steps


def test_lost_steps_are_what_home_says(rig):
    simulated = rig()
    with ready(simulated, **SHORT) as controller:
        simulated.control("drop 3")
        controller.move(2000)
        assert simulated.plant()["pos"] == 1997
        assert controller.home(40000) == 3
        assert controller.home(40000) == 0


def test_a_stalled_motor_shows_at_home(rig):
    simulated = rig()
    with ready(simulated, **SHORT) as controller:
        controller.move(1000)
        simulated.control("stall 1")
        controller.move(3000)
        simulated.control("stall 0")
        assert simulated.plant()["pos"] == 1000
        assert controller.home(40000) == 2000


def forged_lines(chance):
    """LASER lines with something wrong in each of them."""
    good = [seal(f"@{30000 + n} LASER on=1 ms=1000") for n in range(50)]
    for n, line in enumerate(good):
        body, _, _ = line[:-1].rpartition(b"*")
        place = chance.randrange(1, len(body))
        yield (
            body + b"*%04X\n" % chance.randrange(65536),
            body[:place] + bytes([body[place] ^ 1 << chance.randrange(7)]) + line[place + 1 :],
            body + b"\n",
            line.lower(),
            line[:place] + line[place + 1 :],
            line[:place] + line[place : place + 1] + line[place:],
            seal(f"@{30000 + n}  LASER on=1 ms=1000"),
            seal(f"@{30000 + n} LASER on=1 ms=1000 on=1"),
            seal(f"@{30000 + n} LASER on=1 ms=1001"),
            seal(f"@{30000 + n} LASER on=1"),
        )[n % 10]


def test_forged_lines_and_garbage_switch_nothing_on(rig):
    chance = random.Random(1)
    simulated = rig()
    with ready(simulated, speed=10, **SHORT) as controller:
        assert simulated.plant()["contactor"] == 1
        for line in forged_lines(chance):
            garbage = bytes(byte for byte in chance.randbytes(400) if byte != 0x1B)
            controller.link.write(b"\n" + line + garbage + b"\n")
            simulated.run_for(0.03)
        simulated.run_for(0.5)
        assert controller.stat().armed  # Everything was ready for it …
        assert rises(simulated.edges(), "laser") == []
        controller.laser(True, 100)  # … and it would have shown.
        simulated.run_for(0.01)
        controller.laser(False)
        assert len(rises(simulated.edges(), "laser")) == 1


def slow(controller):
    """The settings of now, with a table that never turns faster than it can stop."""
    return replace(controller.settings, speed=400, start_speed=400)


# Malformed lines switch nothing on


def wait_for_light(simulated):
    for _ in range(2000):
        if simulated.plant()["light"]:
            return
        time.sleep(0.001)
    raise AssertionError("the laser never came on")


@pytest.mark.parametrize("begun", [("TRIG", {"ms": 5000}), ("SELFTEST", {}), ("MOVE", {"to": 20_000})])
def test_what_was_stopped_says_its_own_number(rig, begun):
    verb, args = begun
    with contextlib.closing(open_serial(rig(speed=1.0).port)) as link:
        wire = Exchange(link, Clock(), timeout_s=0.25, tries=8)
        wire.ask("HELLO", ses=1)
        wire.ask("SET", wd=60_000)
        wire.ask("EN", on=1)
        wire.ask(verb, **args)
        number = wire.seq
        wire.ask("STOP")
        limit = time.monotonic() + 20.0
        while not (done := [event for event in wire.events if event.name == "DONE"]):
            assert time.monotonic() < limit, list(wire.events)
            wire.listen(0.1)
        assert done[0].fields["seq"] == str(number)
