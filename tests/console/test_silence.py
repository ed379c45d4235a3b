"""A rig that does not answer, or steps that do not end, are said before time-outs end."""

import asyncio
from types import SimpleNamespace

import pytest
from scanrig.controllers.controller import LinkCounts

from jaxscan.cli.console import pages as hub
from jaxscan.cli.console import watching
from jaxscan.cli.console.slate import Slate
from jaxscan.cli.console.watching import Silence

from ..browser.driver import Looks
from ..hardware.fake import ManualClock


@pytest.fixture
def rig():
    """A slate of a sweep, the counts of a controller, a clock, and who listens."""
    slate, counts, clock = Slate(doing="sweep", done=3, planned=10), LinkCounts(), ManualClock()
    listening = Silence(slate, SimpleNamespace(link_counts=counts), clock.now)
    return SimpleNamespace(slate=slate, counts=counts, clock=clock, look=listening.look)


def after(rig, seconds):
    rig.clock.sleep(seconds)
    return rig.look()


def test_questions_without_an_answer_are_said_after_seconds(rig):
    assert after(rig, 60) == ""  # Nothing was asked: homing, or a person with the board.
    rig.counts.unanswered += 1
    assert after(rig, 4) == ""
    rig.counts.unanswered += 1
    assert after(rig, 8) == "no answer from the rig for 12 s"
    # It said no more, but it was asked no more either.
    assert after(rig, 1) == "no answer from the rig for 13 s"
    rig.counts.unanswered = 0
    assert after(rig, 1) == "" and after(rig, 60) == ""


@pytest.mark.parametrize("doing, done, said", [("sweep", 3, 10), ("aim", 10, 10), ("sweep", 10, 0), ("placing", 3, 0)])
def test_steps_that_do_not_end_are_said_where_nobody_has_a_part_in_them(rig, doing, done, said):
    rig.slate.write(doing=doing, done=done)
    assert after(rig, 60) == ""  # Home is not found yet.
    for _ in range(3):
        rig.slate.show(b"a picture")
        assert after(rig, 2) == ""
    assert after(rig, 10) == (f"no finished step for {said} s" if said else "")


def test_slow_steps_are_given_their_time(rig):
    for _ in range(5):
        rig.slate.show(b"a picture")
        rig.look()
        rig.clock.sleep(20)
    rig.slate.show(b"a picture")
    rig.look()
    assert after(rig, 55) == "" and after(rig, 10) == "no finished step for 65 s"


def test_it_is_on_the_slate_while_the_session_runs_and_gone_after_it(console, paper, held, monkeypatch):
    monkeypatch.setattr(watching, "SILENT_S", 0.0)
    monkeypatch.setattr(watching, "_BETWEEN_LOOKS_S", 0.05)
    # The page answers no pings while it waits for the fourth shot, which takes long on a busy machine.
    monkeypatch.setattr(hub, "_HEARTBEAT_S", 120.0)
    waits, go = held(4)

    async def pages(console):
        page = await console.open()
        await page.order("sweep", name="room", resume=False)
        # Nothing new may be told from then on.
        assert await asyncio.to_thread(waits.wait, 60)
        await page.until(lambda page: page.state["doing"] == "sweep")
        paper.controller.link_counts.unanswered += 1
        state = await page.until(lambda page: page.state.get("silence"))
        assert state["silence"].startswith("no answer from the rig for ")
        go.set()
        assert (await page.done())["silence"] == ""

    console.run(pages)


def test_the_page_says_so_instead_of_scanning(browser, console, held, monkeypatch):
    said = [""]
    monkeypatch.setattr(Silence, "look", lambda _: said[0])
    waits, go = held(4)

    def work():
        looks = Looks(browser)
        looks.open(console.address.url(with_token=True))
        looks.click("sweep")
        assert waits.wait(60)
        looks.until(lambda: looks.text("doing") == "scanning")
        said[0] = "no answer from the rig for 12 s"
        looks.until(lambda: looks.text("doing") == "no answer from the rig for 12 s")
        go.set()
        looks.until(lambda: looks.text("doing") == "ready")
        browser.get("about:blank")

    async def pages(console):
        await asyncio.to_thread(work)

    console.run(pages)
