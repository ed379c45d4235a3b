"""How long a laser stays on after whatever should switch it off, on the real firmware, from the pins' log.

`pytest -s` prints the times, all of them in the controller's own time.
"""

import os
import signal
import subprocess
import sys
import time

import pytest
from scanrig.controllers.controller import Settings
from scanrig.controllers.jxs.controller import connect
from scanrig.controllers.jxs.protocol import ABORT, encode
from scanrig.errors import Fault

from .driving import falls, milliseconds, ready, rises, together


HOST = """
import sys
import time
from scanrig.controllers import Settings
from scanrig.controllers.jxs import connect
from scanrig.session import Interrupts

port, doing = sys.argv[1:]
with Interrupts() as should_stop, connect(port) as controller:
    controller.hello()
    controller.configure(Settings(laser_on_ms=5000, settle_ms=0))
    controller.arm(True)
    if doing == "shot":
        controller.shot(40, 1)
    while doing == "between shots":
        controller.poll()
        print("lit", flush=True)
        time.sleep(0.05)
    while not should_stop():
        if doing != "shot":
            controller.laser(True, 1000)
        if doing == "error" and controller.poll().laser:
            print("lit", flush=True)
            raise RuntimeError("something else went wrong")
        if controller.poll().laser:
            print("lit", flush=True)
        time.sleep(0.05)
"""
"""A host that keeps the laser on and says so, until a signal; between shots it only says so."""


def host(simulated, doing):
    """That host, in a process of its own, once the laser is lit."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOST, simulated.port, doing],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdout.readline() == "lit\n", process.communicate()[1]
    return process


def homed(rig, **options):
    """A rig that stands homed, with the driver on and nobody at its port."""
    simulated = rig(**options)
    ready(simulated, speed=1).close()
    simulated.run_for(0.02)
    return simulated


def pin(number):
    """The pin of a laser in the log."""
    return "laser" if number == 1 else "laser_2"


def off_after(simulated, since, event, number=1):
    """Milliseconds from a cycle to the laser's end, which must be an end indeed."""
    off = falls(simulated.edges(), pin(number))[-1]
    assert simulated.plant()[pin(number)] == 0
    assert off["cycle"] >= since, "it was off before"
    took = milliseconds(since, off)
    print(f"\nlaser off {took:9.3f} ms after {event}", end="")
    return took


def finish(process):
    process.wait(20)
    process.stdout.close()
    process.stderr.close()


@pytest.mark.slow
@pytest.mark.parametrize("doing", ["lease", "shot"])
def test_within_600_ms_of_the_hosts_death(rig, doing):
    simulated = homed(rig)
    process = host(simulated, doing)
    dead = simulated.plant()["cycle"]
    assert simulated.plant()["laser"] == 1
    process.kill()
    finish(process)
    simulated.run_for(0.8)
    assert off_after(simulated, dead, f"kill -9 of the host in mid-{doing}") <= 600.0
    assert simulated.plant()["contactor"] == 0
    with connect(simulated.port) as controller:
        controller.hello()
        assert controller.stat().fault is Fault.LINK_LOST


def test_a_failed_mosfet_shines_no_longer_than_ten_seconds_for_a_host_that_died_between_shots(rig):
    simulated = homed(rig)
    process = host(simulated, "between shots")
    simulated.control("laser welded")
    simulated.run_for(0.1)
    dead = simulated.plant()
    assert (dead["light"], dead["laser"], dead["contactor"]) == (1, 0, 1)
    process.kill()
    finish(process)
    simulated.control("speed 0")
    simulated.run_for(10.5)
    opened, dark = (falls(simulated.edges(), pin)[-1] for pin in ("contactor", "light"))
    assert opened["cycle"] == dark["cycle"] and simulated.plant()["contactor"] == 0
    took = milliseconds(dead["cycle"], opened)
    print(f"\ncontactor open {took:9.3f} ms after kill -9 of the host between shots", end="")
    assert 9000.0 < took <= 10500.0
    simulated.control("speed 1")
    with connect(simulated.port) as controller:
        controller.hello()
        status = controller.stat()
        assert (status.state, status.fault, status.armed, status.homed) == ("idle", None, False, True)


def test_the_contactor_opens_ten_seconds_after_the_last_line_and_is_no_fault(rig):
    simulated = rig()
    with ready(simulated, speed=1) as controller:
        controller.configure(Settings(watchdog_ms=500))
        asked = simulated.plant()["cycle"]
        controller.stat()
        answered = simulated.plant()["cycle"]
        simulated.control("speed 0")
        simulated.run_for(10.5)
        simulated.control("speed 1")
        opened = falls(simulated.edges(), "contactor")[-1]
        assert milliseconds(answered, opened) <= 10000.0 <= milliseconds(asked, opened) + 1.0
        status = controller.stat()
        assert (status.state, status.fault, status.armed) == ("idle", None, False)
        controller.arm(True)
        for _ in range(3):
            simulated.run_for(0.3)
            controller.stat()
        assert simulated.plant()["contactor"] == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_at_once_when_the_host_is_asked_to_end(rig, name):
    simulated = homed(rig)
    process = host(simulated, "lease")
    asked = simulated.plant()["cycle"]
    process.send_signal(getattr(signal, name))
    finish(process)
    assert off_after(simulated, asked, f"{name} to the host") <= 400.0
    assert_ended_in_order(simulated)


@pytest.mark.slow
def test_at_once_when_the_host_is_asked_twice(rig):
    simulated = homed(rig)
    process = host(simulated, "shot")
    asked = simulated.plant()["cycle"]
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)
    finish(process)
    assert off_after(simulated, asked, "SIGINT and SIGTERM to the host in mid-shot") <= 400.0
    assert_ended_in_order(simulated)


@pytest.mark.slow
def test_at_once_when_the_host_fails(rig):
    simulated = homed(rig)
    process = host(simulated, "error")
    _, says = process.communicate(timeout=20)
    assert process.returncode == 1 and "something else went wrong" in says
    on = rises(simulated.edges(), "laser")[-1]
    assert off_after(simulated, on["cycle"], "on, with an error in the host") <= 400.0
    assert_ended_in_order(simulated)


def assert_ended_in_order(simulated):
    """The host switched everything off, not a watchdog."""
    assert simulated.plant()["contactor"] == 0
    with connect(simulated.port) as controller:
        controller.hello()
        status = controller.stat()
        assert (status.state, status.fault, status.homed) == ("idle", None, True)


@pytest.mark.parametrize(("kind", "number"), [(0, 1), (1, 1), (1, 2)])
def test_within_270_ms_of_a_hang_with_interrupts_on_or_off(rig, kind, number):
    simulated = rig(firmware="scan_hang")
    # Slow enough that this computer's time to send a line is negligible in the controller's time.
    with ready(simulated, speed=0.2) as controller:
        controller.laser(True, 1000, number=number)
        hangs = simulated.plant()["cycle"]
        controller.link.write(encode(60000, "HANG", k=kind))
        simulated.run_for(0.4)
        assert simulated.plant()["resets"] == 1
        took = off_after(simulated, hangs, f"a hang with interrupts {'off' if kind else 'on'}", number)
        assert 100.0 < took <= 270.0
        simulated.control("speed 0")


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("doing", ["lease", "shot"])
@pytest.mark.parametrize("event", ["estop", "abort", "hello"])
def test_at_once_on_an_emergency_stop_an_abort_or_a_greeting(rig, event, doing, number):
    simulated = rig()
    with ready(simulated, speed=1, laser_on_ms=5000) as controller:
        light(simulated, controller, doing, number)
        if event == "estop":
            simulated.control("estop 1")
            simulated.run_for(0.01)
            since, most_ms = rises(simulated.edges(), "estop")[-1]["cycle"], 0.1
        else:
            simulated.control("speed 0.05")
            since, most_ms = simulated.plant()["cycle"], 20.0
            controller.link.write(ABORT if event == "abort" else encode(60001, "HELLO", ses=9))
            simulated.run_for(0.05)
        assert off_after(simulated, since, f"{event} in mid-{doing}", number) <= most_ms
        opened = falls(simulated.edges(), "contactor")[-1]
        print(f"; contactor {milliseconds(since, opened):.4f} ms", end="")
        assert milliseconds(since, opened) <= most_ms and simulated.plant()["contactor"] == 0
        simulated.control("speed 0")
        if event == "hello":
            controller.hello()
            status = controller.stat()
            assert (status.state, status.fault, status.armed, status.homed) == ("idle", None, False, True)


@pytest.mark.parametrize("before", [b"@77 LASER on=1 ms", b"x" * 400], ids=["in a line", "after 400 bytes"])
def test_at_once_on_an_abort_within_other_bytes(rig, before):
    simulated = rig()
    with ready(simulated, speed=0.05, laser_on_ms=5000) as controller:
        light(simulated, controller, "lease")
        sent = simulated.plant()["cycle"]
        controller.link.write(before + ABORT)
        simulated.run_for(0.1)
        wire = len(before + ABORT) * 0.055  # a byte of the simulated line takes 880 cycles
        took = off_after(simulated, sent, f"an abort behind {len(before)} bytes, {wire:.3f} ms of line")
        assert took <= wire + 2.0
        assert simulated.plant()["contactor"] == 0
        simulated.control("speed 0")
        assert controller.stat().fault is Fault.ABORTED


@pytest.mark.parametrize(("lease", "number"), [(50, 1), (300, 1), (200, 2)])
def test_when_the_lease_runs_out(rig, lease, number):
    simulated = rig()
    with ready(simulated, speed=1) as controller:
        controller.laser(True, lease, number=number)
        end = time.monotonic() + 10.0
        while controller.stat().fault is not Fault.LEASE_RAN_OUT:
            assert time.monotonic() < end
        on = rises(simulated.edges(), pin(number))[-1]
        took = off_after(simulated, on["cycle"], f"on with a lease of {lease} ms", number)
        assert lease - 1.0 <= took <= lease + 1.0
        assert simulated.plant()["contactor"] == 0


@pytest.mark.parametrize("number", [1, 2])
def test_when_the_link_falls_silent(rig, number):
    simulated = rig()
    with ready(simulated, speed=1, watchdog_ms=200) as controller:
        controller.laser(True, 1000, number=number)
        since = simulated.plant()["cycle"]
        simulated.run_for(0.4)
        assert off_after(simulated, since, "silence", number) <= 210.0
        assert simulated.plant()["contactor"] == 0


def test_a_lease_is_renewed_without_a_gap(rig):
    simulated = rig()
    with ready(simulated, speed=1) as controller:
        for _ in range(5):
            controller.laser(True, 1000)
            simulated.run_for(0.3)
        assert len(rises(simulated.edges(), "laser")) == 1
        assert falls(simulated.edges(), "laser")[1:] == []
        assert simulated.plant()["light"] == 1


def light(simulated, controller, doing, number=1):
    """A laser on, by hand or in a shot, and no other."""
    mine, other = ("light", "light_2") if number == 1 else ("light_2", "light")
    if doing == "shot":
        controller.shot(8, 1, number=number)
        end = time.monotonic() + 10.0
        while not simulated.plant()[mine]:
            assert time.monotonic() < end
            controller.poll()
    else:
        controller.laser(True, 1000, number=number)
    assert simulated.plant()[mine] == 1 and simulated.plant()[other] == 0


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
