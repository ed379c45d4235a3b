"""The scan through pages of the console, on a rig on paper."""

import asyncio
import json
import os
import signal
import socket
import threading

import pytest
from scanrig.errors import Fault, PortError

from jaxscan.cli.console.pages import Roles
from jaxscan.files.capture import open_capture, verify_capture


def dark(paper):
    return not paper.table.laser and not paper.table.contactor


def records(console, name="room"):
    assert not verify_capture(console.captures.path(name))
    return len(open_capture(console.captures.path(name)))


async def waiting(event):
    assert await asyncio.to_thread(event.wait, 60)


def test_a_sweep(console, paper):
    paper.camera.faults[5] = "incomplete"

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        state = await page.done()
        assert state["ended"].endswith("room: complete, 10 records.") and state["problem"] == ""
        assert (state["done"], state["planned"], state["left_s"]) == (10, 10, 0.0)
        assert [one["name"] for one in state["captures"]] == ["room"] and state["laser"] == "off"
        (retake,) = [line["says"] for line in state["lines"] if line["kind"] == "retake"]
        assert retake.startswith("step 2 is taken again: ")
        await page.until(lambda page: page.pictures)
        for path in ("/pictures/room/0?lit=1", "/pictures/room/9?small=1"):
            status, body = await console.get(path)
            assert status == 200 and body[:2] == b"\xff\xd8"

    console.run(pages)
    assert records(console) == 10 and dark(paper)


def test_stop_in_mid_shot_and_resume(console, paper, held):
    waits, _ = held(4)

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        await waiting(waits)
        paper.table.laser = True
        await page.order("stop")
        state = await page.done()
        assert state["ended"] == "Stopped: the laser is off." and dark(paper)
        assert "abort" in paper.controller.log
        await page.order("sweep", name="room", resume=True)
        state = await page.done()
        assert state["ended"].endswith("complete, 10 records.")

    console.run(pages)
    assert records(console) == 10


@pytest.mark.parametrize("stopped", [False, True])
def test_a_laser_of_which_nobody_knows_is_not_said_to_be_off(console, paper, held, monkeypatch, stopped):
    waits, go = held(4)
    well, nowhere = paper.controller.make_safe, PortError("there is no port nowhere")

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        await waiting(waits)
        paper.controller.make_safe = lambda: False
        await page.order("stop" if stopped else "pause")
        go.set()
        state = await page.done()
        assert "switch its supply off by hand" in state["problem"] + state["ended"]
        assert state["laser"] == "unknown" and "laser is off." not in state["ended"]
        # Nor is it known after a try that does not reach the rig.
        with monkeypatch.context() as patched:
            patched.setattr("scanrig.controllers.jxs.connect", lambda *_: (_ for _ in ()).throw(nowhere))
            await page.order("sweep", name="room", resume=True)
            state = await page.done()
        assert state["problem"] == str(nowhere) and state["laser"] == "unknown"
        paper.controller.make_safe = well
        await page.order("sweep", name="room", resume=True)
        state = await page.done()
        assert state["ended"].endswith("complete, 10 records.") and state["laser"] == "off"

    console.run(pages)


def test_pause_ends_after_the_step_and_resume_goes_on(console, paper, held):
    waits, go = held(4)

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        await waiting(waits)
        await page.order("pause")
        # An order is carried out in its turn: this answer comes after the pause.
        await page.order("take")
        await page.until(lambda page: page.refused)
        go.set()
        state = await page.done()
        assert "interrupted with 4 of 10 records" in state["ended"] and dark(paper)
        await page.order("sweep", name="room", resume=True)
        assert (await page.done())["ended"].endswith("complete, 10 records.")

    console.run(pages)
    assert records(console) == 10


def test_a_second_session_is_refused(console, held):
    waits, go = held(2)

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        await waiting(waits)
        await page.order("sweep", name="other", resume=False)
        await page.until(lambda page: page.refused)
        assert page.refused == ["the rig is busy: stop or pause it first."]
        go.set()
        await page.done()

    console.run(pages)
    assert not console.captures.path("other").exists()


def test_one_page_operates_and_another_watches(console, paper, held):
    waits, _ = held(3)

    async def pages(console):
        first, second = await console.open(), await console.open()
        assert first.you["operates"] and not second.you["operates"]
        await second.order("sweep", name="room", resume=False)
        await second.until(lambda page: page.refused)
        assert second.refused == ["another page operates: take over first."]
        await first.order("sweep", name="room", resume=False)
        await waiting(waits)
        # Everybody may switch the laser off.
        await second.order("stop")
        assert (await second.done())["ended"] == "Stopped: the laser is off."
        await second.order("take over")
        await second.until(lambda page: page.you["operates"])
        await first.until(lambda page: not page.you["operates"])
        await second.order("sweep", name="room", resume=True)
        await second.done()

    console.run(pages)
    assert records(console) == 10


@pytest.mark.parametrize("key", ["same", "other"])
def test_a_page_that_comes_back_is_what_it_was(console, held, key):
    waits, go = held(3)

    async def pages(console):
        page = await console.open("0" * 32)
        await page.order("sweep", name="room", resume=False)
        await waiting(waits)
        await page.socket.close()
        again = await console.open("0" * 32 if key == "same" else "1" * 32)
        assert again.you["operates"] is (key == "same") and again.state["doing"] == "sweep"
        go.set()
        assert (await again.until(lambda page: page.state["doing"] == "nothing"))["done"] == 10

    console.run(pages)
    assert records(console) == 10


@pytest.mark.parametrize("stops", [False, True])
def test_a_connection_that_is_cut(console, paper, held, monkeypatch, stops):
    monkeypatch.setattr("jaxscan.cli.console.pages.GRACE_S", 0.2)
    waits, go = held(4)

    async def pages(console):
        page = await console.open()
        await page.order("lost", stop=stops)
        await page.until(lambda page: page.state["lost"] == ("stop" if stops else "go on"))
        await page.order("sweep", name="room", resume=False)
        await waiting(waits)
        # In mid-frame, without a farewell.
        wire = page.socket.get_extra_info("socket")
        os.write(wire.fileno(), b"\x81")
        wire.shutdown(socket.SHUT_RDWR)
        await asyncio.sleep(0.6)
        go.set()
        other = await console.open()
        state = await other.until(lambda page: page.state["doing"] == "nothing")
        assert state["done"] == (4 if stops else 10) and other.you["operates"]
        says = [line["says"] for line in state["lines"] if "is lost: paused" in line["says"]]
        assert len(says) == stops
        await page.socket.close()

    console.run(pages)
    assert records(console) == (4 if stops else 10) and dark(paper)


def test_aiming_ends_without_a_page(console, paper, monkeypatch):
    monkeypatch.setattr("jaxscan.cli.console.pages.GRACE_S", 0.2)
    well, broken = Roles.lost_for, []

    def lost_for(roles, now):
        # The watch outlives what goes wrong in it.
        if len(broken) < 3:
            broken.append(1)
            raise OSError(24, "Too many open files")
        return well(roles, now)

    async def pages(console):
        page = await console.open()
        await page.order("aim")
        await page.until(lambda page: page.state["doing"] == "aim" and page.pictures)
        monkeypatch.setattr(Roles, "lost_for", lost_for)
        await page.socket.close()
        async with asyncio.timeout(60):
            while console.slate.read("doing") != "nothing":
                await asyncio.sleep(0.05)
        assert dark(paper) and console.slate.read("laser") == "off"
        says = [line["says"] for line in (await console.open()).state["lines"]]
        assert "The page that operated is lost: the laser goes off, nobody looks at it." in says
        assert len([line for line in says if "the watch over pages: did not succeed" in line]) == 1

    console.run(pages)


def test_the_emergency_stop_is_shown(console, paper, held):
    def press(controller):
        controller.estop = True
        controller.fall_into(Fault.EMERGENCY_STOP)

    paper.controller.before_shot[3] = press

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        state = await page.done()
        assert state["estop"] and "release the e-stop" in state["ended"]
        paper.controller.estop = False
        paper.controller.before_shot.clear()
        waits, go = held(len(paper.controller.shots) + 2)
        await page.order("sweep", name="room", resume=True)
        await waiting(waits)
        await page.until(lambda page: page.state["doing"] == "sweep" and not page.state["estop"])
        go.set()
        state = await page.done()
        assert not state["estop"] and state["done"] == 10

    console.run(pages)


def test_a_rig_that_is_not_there_is_said_in_the_words_of_the_terminal(console, monkeypatch, capsys):
    words = "there is no port nowhere; no serial port was found at all"

    def nowhere(port, baud, clock):
        raise PortError(words)

    monkeypatch.setattr("scanrig.controllers.jxs.connect", nowhere)

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        assert (await page.done())["problem"] == words

    console.run(pages)
    assert f"jaxscan: {words}\n" in capsys.readouterr().out
    assert not console.captures.path("room").exists()


def test_aiming_shows_line_and_exposure_until_a_scan_takes_over(console, paper):
    async def pages(console):
        page = await console.open()
        await page.order("aim")
        state = await page.until(lambda page: page.state.get("live", {}).get("exposure") and page.pictures)
        assert state["doing"] == "aim" and state["live"]["peak_dn"] > 100 and len(state["live"]["stripe"]) > 50
        assert state["live"]["exposure"]["found"].startswith("line ")
        await page.order("sweep", name="room", resume=False)
        await page.until(lambda page: page.state.get("done") == 10 and page.state["doing"] == "nothing")

    console.run(pages)
    assert records(console) == 10 and dark(paper)


def test_table_laser_and_exposure_by_hand_while_somebody_looks(console, paper):
    paper.controller.trigger = lambda ms=None: paper.camera.expose(paper.table.position, paper.table.shines)

    async def pages(console):
        page = await console.open()
        await page.order("jog", deg=10)
        await page.until(lambda page: page.refused)
        assert page.refused[0].startswith("press Look first")
        await page.order("aim")
        await page.until(lambda page: page.state.get("live", {}).get("exposure"))
        assert len(page.state["live"]["histogram"]) == 64
        await page.order("jog", deg=30)
        await page.until(lambda page: page.state["live"].get("angle_deg") == 30.0)
        await page.order("light", on=False)
        await page.until(lambda page: page.state["live"].get("dark"))
        assert dark(paper)
        await page.order("light", on=True)
        await page.until(lambda page: page.state["live"].get("dark") is False)
        await page.order("expose", exposure_ms=12.5, gain_db=1.0)
        await page.until(lambda page: page.state["wish"]["exposure_ms"] == 12.5)
        async with asyncio.timeout(60):
            while paper.controller.settings.exposure_ms != 13:
                await asyncio.sleep(0.05)
        await page.order("auto")
        state = await page.until(lambda page: any("Auto: " in line["says"] for line in page.state["lines"]))
        assert state["wish"]["exposure_ms"] != 12.5
        # Not so short or long that the configuration would refuse it; another page than the one that operates may not.
        watcher = await console.open()
        await watcher.order("expose", exposure_ms=5.0, gain_db=0.0)
        await watcher.until(lambda page: page.refused)
        await page.order("expose", exposure_ms=20.0, gain_db=0.0)
        await page.order("stop")
        await page.until(lambda page: page.state["doing"] == "nothing")
        assert dark(paper) and page.state["laser"] == "off"
        # What follows is exposed as it was set.
        await page.order("sweep", name="room", resume=False)
        await page.done()

    console.run(pages)
    assert records(console) == 10 and dark(paper)
    assert paper.controller.settings.exposure_ms == 20


def test_captures_are_renamed_and_deleted_unless_something_is_done(console, paper, held):
    waits, go = held(4)

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        await waiting(waits)
        for order in ({"do": "delete", "name": "room"}, {"do": "rename", "name": "room", "other": "hall"}):
            await page.socket.send_str(json.dumps(order))
        await page.until(lambda page: len(page.refused) == 2)
        assert all("wait until it is done" in line for line in page.refused)
        go.set()
        await page.until(lambda page: page.state["finished"] == 1)
        await page.order("rename", name="room", other="hall")
        await page.until(lambda page: [one["name"] for one in page.state["captures"]] == ["hall"])
        await page.order("delete", name="hall")
        await page.until(lambda page: page.state["captures"] == [])
        assert (await console.get("/made/hall/mesh"))[0] == 404 and (await console.get("/made/..%2f/mesh"))[0] == 404

    console.run(pages)
    assert not console.captures.path("hall").exists()


def test_ctrl_c_ends_the_console_after_the_step(console, paper):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    pressed = threading.Event()

    def press(controller):
        os.kill(os.getpid(), signal.SIGINT)
        pressed.set()

    paper.controller.before_shot[4] = press

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        await waiting(pressed)

    try:
        with pytest.raises(KeyboardInterrupt, match="SIGINT"):
            console.run(pages)
    finally:
        signal.signal(signal.SIGINT, before)
    assert records(console) == 4 and dark(paper)
