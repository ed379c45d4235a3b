"""What comes over a wire: orders of pages, requests to the gate, lines of controllers."""

import json
import logging
import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from .draft import Case, Draft
from .nasty import nasty_text, nasty_value
from .texts import change_bytes


_ORDERS = ("stop", "take over", "pause", "aim", "sweep", "boards", "take", "enough", "calibrate", "reconstruct")
_ORDERS += ("compare", "lost", "choose", "undo", "clear", "cancel", "remove", "save", "room", "pick")
_FIELDS = ("name", "other", "resume", "stop", "what", "id", "origin", "direction", "cone_rad", "clouds", "section")
_FIELDS += ("turn_rad", "backs", "page")


def _order(rng: random.Random) -> str:
    order = {"do": rng.choice(_ORDERS) if rng.random() < 0.9 else nasty_value(rng)}
    for field in rng.sample(_FIELDS, rng.randrange(6)):
        order[field] = rng.choice(
            (nasty_value(rng), nasty_text(rng), [1.0, 0.0, 0.5], [[0, 0, 0], [1, 1, 1]], 0.01, True, "room", 1)
        )
    if rng.random() < 0.3:
        order["clouds"] = [{"number": rng.choice((0, 1, -1, 2**70, None)), "shift": [0, 0, rng.choice((0, "x"))]}]
    text = json.dumps(order)
    if rng.random() < 0.2:
        text = change_bytes(rng, text.encode(errors="replace")).decode("utf-8", "replace")
    return rng.choice((text, text, text, "[" * 4000, "9" * 5000, f'{{"do": {text}}}'))


def orders_case(draft: Draft) -> Case:
    """Some orders to both parsers: an order or one line."""
    texts = [_order(draft.rng) for _ in range(20)]

    def drive() -> list[str]:
        from jaxscan.cli.console.orders import parse_order as of_console
        from jaxscan.errors import JaxscanError
        from jaxscan.viewer.orders import parse_order as of_viewer

        faults = []
        for text in texts:
            for parse in (of_console, lambda text: of_viewer(text, 2)):
                try:
                    parse(text)
                except JaxscanError as problem:
                    faults += ["lines"] if "\n" in str(problem) else []
        return faults

    return Case("orders", [], drive=drive)


@contextmanager
def quiet() -> Iterator[None]:
    """No lines of the log until the end of `with`."""
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def gate_case(draft: Draft) -> Case:
    """Requests to a server behind the gate: nothing but our own page is let in, and it lives on."""
    rng = draft.rng
    odd = [
        b"Host: evil.com\r\n",
        b"Host: 127.0.0.1@evil.com\r\n",
        b"Origin: http://evil.com\r\n",
        b"Origin: null\r\n",
        b"Sec-Fetch-Site: cross-site\r\n",
        b"Host: x\r\nHost: y\r\n",
        b"Upgrade: websocket\r\nConnection: Upgrade\r\n",
        b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n",
    ]
    heads = b"".join(rng.sample(odd, rng.randrange(1, 3)))
    methods = (b"GET", b"GET", b"HEAD", b"POST", b"CONNECT", b"\x16\x03\x01")
    places = (
        b"/",
        b"/secret",
        b"//evil.com",
        b"/../../etc/passwd",
        b"/%2e%2e/x",
        b"/" + b"a" * 20_000,
        b"*",
        b"\x1b[31m",
    )
    data = rng.choice(methods) + b" " + rng.choice(places) + b" HTTP/1.1\r\n" + heads + b"\r\n"
    if rng.random() < 0.4:
        data = change_bytes(rng, data)

    def drive() -> list[str]:
        from aiohttp import web

        from jaxscan.web import Gate, Server, open_address

        async def page(_: web.Request) -> web.Response:
            return web.Response(text="the page")

        address = open_address("127.0.0.1", 0, option="--web-port")
        site = Gate(address).application()
        site.add_routes([web.get("/secret", page)])
        faults = []
        # A malformed request is a line a minute, which tests/web/test_connections.py holds.
        with quiet(), Server(site, address):
            said = _ask(address.port, data, 0.05)
            # It has no token, whatever it names.
            if b"the page" in said:
                faults.append("let in")
            close = f"HTTP/1.1\r\nHost: 127.0.0.1:{address.port}\r\nConnection: close\r\n"
            welcome = _ask(address.port, f"GET /?token={address.token} {close}\r\n".encode(), 5.0).decode()
            cookie = welcome.partition("Set-Cookie: ")[2].partition(";")[0]
            if b"the page" not in _ask(address.port, f"GET /secret {close}Cookie: {cookie}\r\n\r\n".encode(), 5.0):
                faults.append("dead")
        return faults

    return Case("gate", [], drive=drive, allowed=frozenset({"network"}))


def _ask(port: int, data: bytes, wait_s: float) -> bytes:
    """What is answered until the other end closes, or is silent for some time."""
    with socket.create_connection(("127.0.0.1", port), timeout=wait_s) as connection:
        said = b""
        try:
            connection.sendall(data)
            while more := connection.recv(65536):
                said += more
        except OSError:
            # Closed in the middle, or half a request for whose end it waits.
            return said
        return said


_SAID = ("OK 1 pos=0", "ERR 3 code=5", "EV STATE pos=1", "<Idle|MPos:1.0,0,0|FS:0,0>", "ok", "error:9", "ALARM:1")
_SAID += ("$100=250.0", "Grbl 1.1h ['$' for help]", "[VER:1.1h:]", "jaxscan 2 boot=7 was=3")


def wire_case(draft: Draft) -> Case:
    """Lines of a controller, changed and cut, to all parsers of answers."""
    rng = draft.rng
    lines = []
    for _ in range(30):
        text = rng.choice((rng.choice(_SAID), nasty_text(rng)[:500])).encode("utf-8", "replace")
        lines.append(change_bytes(rng, text) if rng.random() < 0.7 and text else text)

    def drive() -> list[str]:
        from scanrig.controllers.grbl.lines import read_report, read_settings

        for line in lines:
            text = line.decode("latin-1")
            read_report(text)
            read_settings([text])
        return _session(lines)

    return Case("controller", [], drive=drive)


def _session(lines: list[bytes]) -> list[str]:
    """A controller of jaxscan's own that says these lines; a greeting ends with one line or with none."""
    from scanrig.controllers.jxs.controller import JxsController

    from jaxscan.errors import JaxscanError

    from ..hardware.fake import FakeController

    fake = FakeController()
    for line in lines:
        fake.say(line)
    try:
        JxsController(fake, fake.clock, session=1).hello()
    except JaxscanError as problem:
        return ["lines"] if "\n" in str(problem) else []
    return []
