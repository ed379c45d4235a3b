"""What a page may send, who of several pages operates, and what is shown of a folder."""

import asyncio
import json

import aiohttp
import pytest

from jaxscan.cli.console.orders import BadOrder, Order, parse_order
from jaxscan.cli.console.pages import GRACE_S, Roles


def test_orders_that_are_understood():
    assert parse_order('{"do": "stop"}') == Order("stop")
    text = '{"do": "sweep", "name": "room_1.b-2", "resume": true}'
    assert parse_order(text) == Order("sweep", "room_1.b-2", resume=True)
    assert parse_order('{"do": "compare", "name": "a", "other": "b"}') == Order("compare", "a", "b")
    assert parse_order('{"do": "jog", "deg": -10}') == Order("jog", deg=-10)
    assert parse_order('{"do": "expose", "exposure_ms": 12.5, "gain_db": 0}') == Order("expose", exposure_ms=12.5)
    assert parse_order('{"do": "light", "on": true}') == Order("light", on=True)


NAMES = ["", "..", "../room", "a/../b", "/etc", "a/b", "a\\b", ".hidden", "-o", "a" * 65, "a\n", "a..b", "é"]
NAMES += [7, None, ["a"], True]
MESSAGES = [
    "",
    "{",
    "[]",
    "null",
    "7",
    '"stop"',
    "{}",
    '{"do": 7}',
    '{"do": ["stop"]}',
    '{"do": "laser"}',
    '{"do": "laser", "on": true}',
    '{"do": "stop", "more": 1}',
    '{"do": "sweep", "name": "room"}',
    '{"do": "sweep", "name": "room", "resume": 1}',
    '{"do": "lost", "stop": "yes"}',
    "[" * 4000,
    *(f'{{"do": "jog", "deg": {deg}}}' for deg in ("1e9", "NaN", "Infinity", "true", '"1"', "null", "[1]", "9" * 400)),
    *(f'{{"do": "expose", "exposure_ms": {ms}, "gain_db": 0}}' for ms in ("0", "-1", "1e5", "NaN", "true")),
    '{"do": "expose", "exposure_ms": 10, "gain_db": 101}',
    '{"do": "light", "on": 1}',
    '{"do": "delete", "name": "../room"}',
    '{"do": "rename", "name": "room", "other": "../room"}',
    '{"do": "rename", "name": "room"}',
    *(json.dumps({"do": "sweep", "name": name, "resume": False}) for name in NAMES),
]


@pytest.mark.parametrize("text", MESSAGES, ids=range(len(MESSAGES)))
def test_all_else_is_refused_in_one_line(text):
    with pytest.raises(BadOrder) as problem:
        parse_order(text)
    assert "\n" not in str(problem.value)


def test_the_first_page_operates_and_comes_back_as_itself():
    roles = Roles()
    roles.join("a", 0.0)
    roles.join("b", 1.0)
    assert roles.operator == "a"
    roles.leave("a", 2.0)
    assert roles.operator == "a" and roles.lost_for(3.0) == 1.0
    roles.join("c", 3.0)
    assert roles.operator == "a"
    roles.join("a", 3.0)
    assert roles.operator == "a" and roles.lost_for(9.0) == 0.0


def test_a_page_that_stays_away_is_followed_by_the_next_that_comes():
    roles = Roles()
    roles.join("a", 0.0)
    roles.leave("a", 1.0)
    roles.join("b", 1.0 + 1.01 * GRACE_S)
    assert roles.operator == "b"
    roles.join("a", 20.0)
    assert roles.operator == "b"
    roles.take_over("a")
    assert roles.operator == "a"


def test_a_copied_tab_does_not_end_the_first_one():
    roles = Roles()
    roles.join("a", 0.0)
    roles.join("a", 1.0)
    roles.leave("a", 2.0)
    assert roles.lost_for(9.0) == 0.0


def test_messages_that_are_no_orders_change_nothing(console):
    async def pages(console):
        page = await console.open()
        await page.socket.send_str("garbage")
        await page.until(lambda page: page.refused)
        assert page.refused == ["a message that is no JSON."]
        # A copied tab has the same name, and watches.
        copy = await console.open(page.key)
        assert not copy.you["operates"]
        for sent, code in ((b"\x00", 1000), ("a" * 5000, aiohttp.WSCloseCode.MESSAGE_TOO_BIG)):
            other = await console.open()
            await (other.socket.send_bytes if isinstance(sent, bytes) else other.socket.send_str)(sent)
            while (await other.socket.receive(10)).type is not aiohttp.WSMsgType.CLOSE:
                pass
            assert other.socket.close_code == code
        await page.order("take")
        await page.until(lambda page: len(page.refused) == 2)
        assert page.refused[1] == "nobody asked for the board."

    console.run(pages)
    assert console.slate.read("finished") == 0


@pytest.mark.parametrize("greeting", ["{}", "garbage", '{"page": "short"}', '{"page": ["a"]}', "7", b"\x00"])
def test_a_page_that_does_not_begin_with_its_name_is_closed(console, greeting):
    async def pages(console):
        async with console.connect() as socket:
            await (socket.send_bytes if isinstance(greeting, bytes) else socket.send_str)(greeting)
            assert (await socket.receive(10)).type is aiohttp.WSMsgType.CLOSE

    console.run(pages)


def test_a_page_that_says_nothing_is_closed_and_counts_until_then(console, monkeypatch):
    monkeypatch.setattr("jaxscan.cli.console.pages._GREET_S", 1.0)

    async def pages(console):
        mute = [await console.connect(autoping=False) for _ in range(12)]
        with pytest.raises(AssertionError, match="too many pages"):
            await console.open()

        async def until_closed(socket):
            # Answers to pings are no greeting.
            while True:
                await socket.ping()
                if (await socket.receive(10)).type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED):
                    return
                await asyncio.sleep(0.05)

        await asyncio.wait_for(asyncio.gather(*map(until_closed, mute)), 30)
        assert (await console.open()).you["operates"]

    console.run(pages)


def test_a_page_that_cannot_be_told_is_closed_and_the_next_is_told(console, monkeypatch):
    well, broken = console.slate.picture, []

    def once():
        if not broken:
            broken.append(1)
            raise OSError(24, "Too many open files")
        return well()

    monkeypatch.setattr(console.slate, "picture", once)

    async def pages(console):
        page = await console.open()
        while (message := await page.socket.receive(10)).type is not aiohttp.WSMsgType.CLOSE:
            pass
        assert message.data == 1011
        again = await console.open()
        assert any("what a page is told: did not succeed" in line["says"] for line in again.state["lines"])

    console.run(pages)


PATHS = [
    "/pictures/room/0",
    "/pictures/../0",
    "/pictures/%2e%2e/0",
    "/pictures/..%2f..%2fetc/0",
    "/pictures/evil/0",
    "/pictures/evil/99999999",
    "/pictures/evil/-1",
    "/clouds/room",
    "/clouds/..%2froom",
    "/clouds/evil",
    "/socket/..",
    "/page/index.html",
    "/captures.py",
]


def test_no_address_leads_to_another_file(console):
    folder = console.captures.folder / "evil"
    folder.mkdir(parents=True)
    (folder / "capture.toml").write_text("no capture")
    (folder.parent / "evil.ply").write_bytes(b"ply\nno cloud\n")
    (folder.parent / "..evil").mkdir()

    async def pages(console):
        for path in PATHS:
            status, body = await console.get(path)
            assert status == 404 and len(body) < 400, path
        assert (await console.get("/socket"))[0] == 400
        page = await console.open()
        (listed,) = page.state["captures"]
        assert listed["name"] == "evil" and listed["records"] == 0 and "\n" not in listed["problem"]

    console.run(pages)
