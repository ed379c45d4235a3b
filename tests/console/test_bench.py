"""A scan from a real browser on the bench: the real firmware, its pins' log, a network camera."""

import json
import time
from pathlib import Path

import pytest

from jaxscan.files.capture import open_capture, verify_capture

from ..browser.driver import Looks
from ..hardware import conftest as hardware
from ..hardware.driving import falls, milliseconds
from .conftest import console_process


ROOT = Path(__file__).resolve().parents[2]
ALLOWED_MS = 300.0
"""From Stop on the page to the laser's end."""
STEPS = 8
NEEDS = (hardware.missing_for_the_rig, hardware.missing_for_the_loopback, hardware.missing_for_the_camera)


@pytest.fixture
def bench(tmp_path):
    """A rig with its camera, and the configuration of a short sweep whose laser shines long."""
    if reason := next((said for check in NEEDS if (said := check())), ""):
        if hardware.REQUIRED:
            raise pytest.UsageError(f"JAXSCAN_REQUIRE_BENCH is set, but {reason}")
        pytest.skip(reason)
    from bench.desk import set_up
    from bench.places import WORLD

    with set_up(tmp_path / "bench", world=WORLD, wait_s=600.0) as desk:
        text = (ROOT / "configs" / "bench.toml").read_text()
        text = text.replace("hardware/bench/build/desk/port", str(desk.rig.port))
        text = text.replace("steps = 180", f"steps = {STEPS}").replace("on_ms = 20", "on_ms = 1500")
        (tmp_path / "rig.toml").write_text(text)
        yield desk


@pytest.fixture
def url(bench, tmp_path):
    """The address of a console in a process of its own."""
    with console_process(tmp_path) as (address, _):
        yield address


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_stop_on_the_page_puts_the_laser_out_and_a_reload_loses_nothing(bench, url, browser, tmp_path):
    looks = Looks(browser)
    looks.open(url)
    looks.click("sweep")

    def wait(holds, limit_s=120.0):
        end = time.monotonic() + limit_s
        while not holds():
            assert time.monotonic() < end, looks.text("problem")
            time.sleep(0.02)

    for stopped_after in (2, 4):
        wait(lambda n=stopped_after: looks.text("count").startswith(f"room: {n} of"))
        # In mid-scan.
        looks.driver.refresh()
        wait(lambda: looks.text("doing") == "scanning")
        wait(lambda: bench.rig.plant()["light"])
        before = bench.rig.plant()["cycle"]
        looks.at("stop").click()
        wait(lambda: looks.text("doing") == "ready")
        bench.rig.run_for(0.5)
        edges = bench.rig.edges()
        dark = falls(edges, "light")[-1]
        took = milliseconds(before, dark)
        print(f"\nlaser off {took:.1f} ms after Stop was clicked")
        assert 0 <= took <= ALLOWED_MS
        state = bench.rig.plant()
        assert not state["light"] and not state["laser"] and not state["contactor"]
        looks.click("resume")
    # A page that is closed loses nothing: the scan goes on, as it was chosen.
    wait(lambda: looks.text("doing") == "scanning")
    looks.driver.get("about:blank")
    journal = tmp_path / "captures" / "room" / "frames.jsonl"
    wait(lambda: json.loads(journal.read_text().splitlines()[-1]).get("event") == "end" and STEPS == done(journal))
    assert not verify_capture(journal.parent) and len(open_capture(journal.parent)) == STEPS
    looks.open(url)
    wait(lambda: f"complete, {STEPS} records" in looks.text("ended"))
    wait(lambda: not bench.rig.plant()["contactor"])


def done(journal):
    """Records in a journal."""
    return len({line["i"] for line in map(json.loads, journal.read_text().splitlines()) if "i" in line})
