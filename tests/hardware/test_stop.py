"""An action that is ended is reported by the number of the line that began it, on the real firmware."""

import contextlib
import time

import pytest
from scanrig.clock import Clock
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.wire import open_serial


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
