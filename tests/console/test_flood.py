"""Half-open connections by the thousand: the scan, Stop and those who have the token do not notice."""

import asyncio
import itertools
import json
import logging
import statistics
import time
from urllib.parse import urlsplit

import aiohttp
import pytest

from jaxscan.files.capture import open_capture, verify_capture
from jaxscan.web import open_address

from ..hardware.driving import falls, milliseconds
from ..web.asking import ask, let_in, page_of, served
from .conftest import Page, console_process
from .flood import Flood
from .test_bench import ALLOWED_MS, ROOT
from .test_bench import bench as bench


LATE_S = 10.0
"""After which the rig's configuration calls a step late."""
STEPS = 60
MOST = 5000
HELD = 300
"""Of them at once: far below the limit of open files, which this process shares."""
FEW_LINES = 3


def get(port, cookie=None):
    """Status of an answer, and its seconds."""
    start = time.monotonic()
    return ask(port, Cookie=cookie)[0], time.monotonic() - start


def test_pages_with_the_token_are_answered_in_a_small_flood(caplog):
    address = open_address("127.0.0.1", 0, option="--web-port")
    port, token = address.port, address.token
    with served(address, page_of(b"the page")), caplog.at_level(logging.INFO):
        cookie = let_in(port, token)
        with Flood(port, held=200, per_s=2000.0, most=200) as flood:
            while not flood.spent:
                assert get(port, cookie)[0] == 200
            # Somebody who comes in the middle of it, too.
            assert let_in(port, token) == cookie
            assert get(port, cookie)[0] == 200
        assert flood.ended > 0, "most have to give way"
        assert get(port)[0] == 403
    assert len(caplog.records) <= FEW_LINES, caplog.text


@pytest.fixture
def console(bench, tmp_path):
    """A console in a process of its own: `configure(on_ms)`, and its address and output."""

    def configure(on_ms):
        text = (ROOT / "configs" / "bench.toml").read_text()
        assert "steps = 180" in text and "on_ms = 20" in text and f"late_s = {LATE_S}" in text
        text = text.replace("steps = 180", f"steps = {STEPS}\nturn_deg = {STEPS}.0")
        text = text.replace("hardware/bench/build/desk/port", str(bench.rig.port))
        (tmp_path / "rig.toml").write_text(text.replace("on_ms = 20", f"on_ms = {on_ms}"))

    configure(20)
    with console_process(tmp_path) as (url, output):
        yield configure, url, output


def gaps(folder):
    """Seconds between records, by the journal, of a capture in which none is late, lost or damaged."""
    assert not verify_capture(folder)
    lines = [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]
    records = [line for line in lines if "i" in line]
    assert [record["i"] for record in records] == list(range(STEPS)) == [r.i for r in open_capture(folder).records]
    assert not sum(record["retakes"] for record in records)
    assert not [line for line in lines if line.get("event") in ("retake", "fault", "recovered")]
    times = [record["time_s"] for record in records]
    return [later - earlier for earlier, later in itertools.pairwise(times)]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_five_thousand_half_open_connections_do_not_disturb_a_scan(bench, console, tmp_path):
    configure, url, said = console
    captures, answers = tmp_path / "captures", []
    parts = urlsplit(url)
    port, cookie = parts.port, let_in(parts.port, parts.query.removeprefix("token="))

    async def pages():
        own = f"http://127.0.0.1:{port}"
        async with aiohttp.ClientSession() as session:
            page = Page(await session.ws_connect(f"{own}/socket", headers={"Origin": own, "Cookie": cookie}), "0" * 32)
            await page.socket.send_str(json.dumps({"page": page.key}))
            await page.until(lambda page: True)
            await scan(page, "still")
            lines = len(said.read_text().splitlines())
            # The flood begins in mid-scan: a camera that is opened within one may have to be opened twice.
            await page.order("sweep", name="flooded", resume=False)
            await page.until(lambda page: taken(page, "flooded") >= 1)
            with Flood(port, held=HELD, per_s=600.0) as flood:
                await asyncio.gather(to_its_end(page, "flooded"), ask_until(lambda: "flooded" in ended(page)))
                assert flood.opened >= MOST
                quiet = len(said.read_text().splitlines())
                configure(1500)
                await page.order("sweep", name="stopped", resume=False)
                await page.until(lambda page: taken(page, "stopped") >= 1)
                while not bench.rig.plant()["light"]:
                    await asyncio.sleep(0.02)
                before = bench.rig.plant()["cycle"]
                await page.order("stop")
                await page.done()
            return lines, quiet, before, flood

    async def scan(page, name):
        await page.order("sweep", name=name, resume=False)
        await to_its_end(page, name)

    async def to_its_end(page, name):
        for k in range(STEPS):
            await page.until(lambda page, k=k: taken(page, name) > k)
        await page.done()
        assert f"{STEPS} records" in ended(page), page.state

    def taken(page, name):
        return page.state["done"] if page.state.get("capture") == name else 0

    def ended(page):
        return page.state["ended"] + page.state["problem"]

    async def ask_until(holds):
        while not holds():
            status, took = await asyncio.to_thread(get, port, cookie)
            assert status == 200
            answers.append(took)
            await asyncio.sleep(0.2)

    lines, quiet, before, flood = asyncio.run(pages())
    assert flood.opened >= MOST and flood.ended > 0
    still, flooded = gaps(captures / "still"), gaps(captures / "flooded")
    print(f"\n{flood.opened} connections, {flood.highest} at once; {len(answers)} pages answered in")
    print(f"{statistics.median(answers):.3f} s (median), {max(answers):.3f} s at most; a record in")
    print(f"{statistics.median(flooded):.2f} s (median), {max(flooded):.2f} s at most; without flood in")
    print(f"{statistics.median(still):.2f} s, {max(still):.2f} s at most")
    assert max(flooded) < LATE_S
    bench.rig.run_for(0.5)
    took = milliseconds(before, falls(bench.rig.edges(), "light")[-1])
    print(f"laser off {took:.1f} ms after Stop")
    assert 0 <= took <= ALLOWED_MS
    state = bench.rig.plant()
    assert not state["light"] and not state["laser"] and not state["contactor"]
    # The sentences of a scan are as many as without a flood, which adds a line or two at most.
    assert quiet - lines <= FEW_LINES + lines, said.read_text()
