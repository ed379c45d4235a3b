"""Threads of the console outlive an exception, and say it."""

import threading
import time

import numpy as np
import pytest

from jaxscan.cli.console.captures import Captures
from jaxscan.cli.console.desk import Desk
from jaxscan.cli.console.orders import Order
from jaxscan.cli.console.slate import Slate
from jaxscan.cli.console.watching import Painter, Seen, Silence
from jaxscan.cli.console.works import Work, Works
from jaxscan.cli.terminal import Terminal
from jaxscan.vision import to_grey

from .conftest import CONFIG


def says(slate, *kinds):
    """The sentences of these kinds, or of all."""
    return [line["says"] for line in slate.state(0)[1]["lines"] if not kinds or line["kind"] in kinds]


def test_a_work_that_fails_takes_no_other_with_it(tmp_path, monkeypatch):
    slate, ended = Slate(), threading.Event()

    def call(works, words, lines):
        if "broken" in words:
            raise OSError(24, "Too many open files")
        return 0

    def fail(well, result):
        raise ValueError("no such\ncapture")

    monkeypatch.setattr(Works, "_call", call)
    with Works(slate, Captures(tmp_path)) as works:
        works.begin(Work("reconstruct room", ["broken"]))
        works.begin(Work("calibrate boards", ["well"], fail))
        works.begin(Work("compare", ["well"], lambda well, result: ended.set()))
        assert ended.wait(30)
        while works.busy:
            time.sleep(0.01)
    assert says(slate, "problem") == [
        "reconstruct room: did not succeed: [Errno 24] Too many open files",
        "calibrate boards: did not succeed: no such capture",
    ]
    assert says(slate, "note")[-2:] == ["compare begins.", "compare: done."]
    found = {one["what"]: (one["running"], one["well"]) for one in slate.read("works")}
    assert found == {
        "reconstruct room": (False, False),
        "calibrate boards": (False, True),
        "compare": (False, True),
    }


def test_the_watch_over_the_rig_goes_on_and_says_a_failure_once(paper, monkeypatch):
    slate, looks, enough = Slate(), [], threading.Event()

    def look(silence):
        looks.append(1)
        if len(looks) < 4:
            raise OSError(24, "Too many open files")
        enough.set()
        return "the controller is silent"

    monkeypatch.setattr(Silence, "look", look)
    monkeypatch.setattr("jaxscan.cli.console.watching._BETWEEN_LOOKS_S", 0.01)
    with Silence(slate, paper.controller):
        assert enough.wait(30)
    assert says(slate) == ["the watch over the rig: did not succeed: [Errno 24] Too many open files"]


@pytest.mark.more
def test_the_painter_goes_on_after_a_picture_that_failed(tmp_path, monkeypatch):
    from scanrig.config import load_rig

    (tmp_path / "rig.toml").write_text(CONFIG)
    rig, slate, enough = load_rig(tmp_path / "rig.toml"), Slate(), threading.Event()
    drawn = []

    def fail_first(frame, pixel_format):
        drawn.append(frame)
        # Before the first picture one is drawn for each laser, to compile what finds its stripe.
        if len(drawn) == len(rig.laser) + 1:
            raise ValueError("no such\nframe")
        if len(drawn) == len(rig.laser) + 3:
            enough.set()
        return to_grey(frame, pixel_format)

    monkeypatch.setattr("jaxscan.cli.console.captures.to_grey", fail_first)
    monkeypatch.setattr("jaxscan.cli.console.watching._BETWEEN_PICTURES_S", 0.0)
    shown = []
    monkeypatch.setattr(slate, "show", shown.append)
    frame = np.zeros((rig.camera.height, rig.camera.width), np.uint8)
    with Painter(rig, slate) as painter:
        until = time.monotonic() + 30.0
        while not enough.wait(0.02) and time.monotonic() < until:
            painter.show(Seen(None, frame, 0, {}))
    assert enough.is_set() and shown and says(slate) == ["the camera's picture: did not succeed: no such frame"]


def test_the_desk_goes_on_after_a_list_of_captures_that_failed(tmp_path, monkeypatch):
    """Nor does an order that fails in an unknown way take the next one with it."""
    carried = []

    def carry_out(desk, order):
        carried.append(order.do)
        raise ValueError("no such\norder")

    def fail():
        raise OSError(24, "Too many open files")

    slate = Slate(lost="go on", doing="nothing", finished=0)
    desk = Desk(tmp_path / "rig.toml", slate, Terminal())
    monkeypatch.setattr(Desk, "_open_and_run", carry_out)
    desk.after = fail
    for do in ("aim", "sweep"):
        desk.ask(Order(do))
    desk.leave()
    desk.attend()
    said = says(slate)
    assert carried == ["aim", "sweep"] and slate.read("finished") == 2
    assert said.count("the list of captures: did not succeed: [Errno 24] Too many open files") == 1
    assert sum("no such order" in line for line in said) == 2
