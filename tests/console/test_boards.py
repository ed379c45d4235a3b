"""Captures of the board through a page, on a rig on paper that sees rendered boards."""

import pytest

from jaxscan.files.capture import open_capture

from ..hardware.desk import Desk as PaperDesk
from .conftest import CONFIG


BOARD = """
[board]
type = "chessboard"
columns = 7
rows = 5
square_mm = 80.0
[calibration]
free_views = 3
placements = 1
angles_deg = [-5.0, 0.0, 5.0]
"""


@pytest.fixture
def seen(console, paper, tiny, monkeypatch):
    """What the camera sees: a list of [laser-on, laser-off] frames, boards first; `seen.showing` is one of them."""
    capture = open_capture(tiny.boards)
    desk = PaperDesk(camera={"width": 320, "height": 256})
    desk.pairs = [capture.frames(n) for n in range(3)]
    desk.blank = open_capture(tiny.sweep).frames(0)
    desk.showing = desk.blank
    desk.see = lambda position, lit: desk.showing[0 if lit else 1]
    desk.camera.close = lambda: None
    controller = paper.controller
    controller.table, controller.camera = desk.table, desk.camera
    controller.trigger = lambda: desk.camera.expose(desk.table.position, desk.table.shines)
    monkeypatch.setattr("scanrig.cameras.open_camera", lambda settings, say: desk.camera)
    text = CONFIG.replace("width = 128", "width = 320").replace("height = 96", "height = 256")
    console.config.write_text(text + BOARD)
    # Calibrations of three views have nothing to say, and take a process.
    monkeypatch.setattr("jaxscan.cli.console.works.Works.carry_out", lambda self, order, of="": None)
    return desk


@pytest.mark.more
def test_a_person_is_guided_and_says_when(console, seen):
    async def pages(console):
        page = await console.open()
        await page.order("boards", name="boards", resume=False)
        state = await page.until(lambda page: (page.state.get("guide") or {}).get("problem"))
        assert state["doing"] == "placing" and state["placing"] == {
            "kind": "free",
            "number": 0,
            "total": 3,
            "at_deg": 0.0,
        }
        assert state["guide"]["problem"].startswith("no board found") and state["guide"]["pose"] is None
        assert "hold the board still" in state["guide"]["advice"][0]
        # Nothing is taken while no board is seen.
        await page.order("take")
        for number in range(2):
            seen.showing = seen.pairs[number]
            state = await page.until(lambda page: page.state["guide"]["pose"] and page.state["doing"] == "placing")
            assert len(state["guide"]["found"]) == 35 and 0 < state["guide"]["pose"]["depth_m"] < 10
            await page.order("take")
            state = await page.until(lambda page, n=number + 1: page.state["placing"]["number"] == n)
            await page.until(lambda page, n=number + 1: page.state["guide"]["views"] == n)
            assert sum(map(sum, state["guide"]["corners"])) > 0
        await page.order("enough")
        await page.until(lambda page: page.state["placing"]["kind"] == "placement")
        await page.until(lambda page: page.state["doing"] == "placing")
        await page.order("take")
        state = await page.until(lambda page: page.state["finished"])
        assert state["ended"].endswith("complete, 5 records.") and state["placing"] is None

    console.run(pages)
    assert len(open_capture(console.captures.path("boards"))) == 5
    assert not seen.table.contactor


def test_stop_while_somebody_is_asked(console, seen):
    async def pages(console):
        page = await console.open()
        await page.order("boards", name="boards", resume=False)
        await page.until(lambda page: page.state["doing"] == "placing")
        await page.order("stop")
        assert (await page.done())["ended"] == "Stopped: the laser is off."
        await page.order("take")
        await page.until(lambda page: page.refused)

    console.run(pages)
    assert not seen.table.contactor
