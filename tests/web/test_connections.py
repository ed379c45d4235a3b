"""Connections: how many there may be, how long each may take, who gives way, and what is said of them."""

import asyncio
import dataclasses
import errno
import logging
import os
import socket
import time

import pytest
from aiohttp import web

from jaxscan.cli.running import LogLines, say_line
from jaxscan.web import connections, open_address, server
from jaxscan.web.connections import Connections

from .asking import PATIENCE_S, ask, let_in, page_of, served


PAGE = page_of(b"the page")


async def talk(request):
    socket = web.WebSocketResponse()
    await socket.prepare(request)
    async for message in socket:
        await socket.send_str(message.data)
    return socket


@pytest.fixture
def address():
    return open_address("127.0.0.1", 0, option="--web-port")


class Guest:
    """Somebody with the cookie."""

    def __init__(self, address):
        self.port = address.port
        self.place = f"127.0.0.1:{self.port}"
        self.cookie = let_in(self.port, address.token)

    def is_answered(self):
        return ask(self.port, Cookie=self.cookie)[0] == 200

    def call(self, path="/", **headers):
        """A connection with a request on it whose answer has come."""
        opened = connect(self)
        given = {"Host": self.place, "Cookie": self.cookie, **headers}
        opened.sendall(f"GET {path} HTTP/1.1\r\n".encode() + lines(given))
        assert opened.recv(4096)
        return opened


def lines(headers):
    return "".join(f"{name}: {value}\r\n" for name, value in headers.items()).encode() + b"\r\n"


def connect(address):
    return socket.create_connection(("127.0.0.1", address.port), timeout=PATIENCE_S)


def is_closed(opened):
    """Whether the other end has closed a connection."""
    opened.setblocking(False)
    try:
        return opened.recv(4096) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


def until(holds):
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def hasty(monkeypatch):
    monkeypatch.setattr(server, "_LOOK_S", 0.05)
    monkeypatch.setattr(connections, "HEAD_S", 0.4)
    monkeypatch.setattr(connections, "IDLE_S", 0.5)
    monkeypatch.setattr(connections, "READ_S", 0.4)


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\n"])
def test_a_head_has_to_be_complete_in_its_time(address, hasty, sent):
    with served(address, PAGE), connect(address) as slow:
        slow.sendall(sent)
        # A little more now and then does not give it more time.
        begun, n = time.monotonic(), 0
        while not is_closed(slow):
            assert time.monotonic() - begun < PATIENCE_S
            n += 1
            if sent:
                try:
                    slow.sendall(f"X-{n}: x\r\n".encode())
                except ConnectionError:
                    break
            time.sleep(0.05)
        assert Guest(address).is_answered()


def test_a_connection_without_a_next_request_ends_and_a_socket_stays(address, hasty):
    with served(address, PAGE, web.get("/talk", talk)):
        guest = Guest(address)
        key = {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Version": "13", "Connection": "Upgrade"}
        origin = {"Origin": f"http://{guest.place}", "Upgrade": "websocket"}
        with guest.call() as idle, guest.call("/talk", **key, **origin) as stays:
            until(lambda: is_closed(idle))
            time.sleep(0.6)
            assert not is_closed(stays)


class Transport(asyncio.Transport):
    """What a connection sees of its wire."""

    waiting, ended = 0, False

    def get_write_buffer_size(self):
        return self.waiting

    def abort(self):
        self.ended = True


def admitted(there, address):
    """A connection that is made, and its wire."""
    wire = Transport()
    one = there.admit(asyncio.Protocol(), address)
    one.connection_made(wire)
    return one, wire


def test_who_reads_nothing_of_what_waits_for_him_is_late():
    now, transport = [0.0], Transport()
    one = Connections(lambda: now[0]).admit(asyncio.Protocol(), "192.0.2.1")
    one.connection_made(transport)
    one.begin()
    for at, waiting, late in (
        (0.0, 0, False),
        (100.0, 50, False),
        (109.0, 50, False),
        (111.0, 40, False),
        (120.0, 40, False),
    ):
        now[0], transport.waiting = at, waiting
        assert one.is_late(at) is late
    transport.waiting = 60
    assert one.is_late(121.5)


def test_the_oldest_of_the_address_that_has_most_gives_way():
    there = Connections(lambda: 0.0)
    guest, guests = admitted(there, "192.0.2.1")
    assert guest.welcome()
    _, others = admitted(there, "192.0.2.9")
    many = [admitted(there, "192.0.2.1")[1] for _ in range(3 * there.most_of_one)]
    assert [wire.ended for wire in many] == 2 * there.most_of_one * [True] + there.most_of_one * [False]
    assert not guests.ended and not others.ended
    # Of many addresses, too.
    for n in range(3 * there.most_strangers):
        admitted(there, f"198.51.100.{n}")
    assert len(there) == there.most_strangers + 1 and not guests.ended


def test_guests_have_a_limit_too():
    there = Connections(lambda: 0.0)
    come = [there.admit(asyncio.Protocol(), "192.0.2.1").welcome() for _ in range(there.most_guests + 1)]
    assert come == there.most_guests * [True] + [False]


def test_a_guest_is_answered_while_strangers_hold_hundreds_of_connections(address):
    with served(address, PAGE):
        guest = Guest(address)
        held = [connect(address) for _ in range(200)]
        for one in held:
            try:
                one.sendall(b"GET / HTTP/1.1\r\nHost: ")
            except ConnectionError:
                continue
        assert all(guest.is_answered() for _ in range(20))
        until(lambda: sum(not is_closed(one) for one in held) <= Connections().most_of_one)
        # One that comes anew, with the token alone, gets in as well.
        assert Guest(address).is_answered()
        for one in held:
            one.close()


def test_without_descriptors_somebody_is_turned_away_and_the_door_opens_again(address, monkeypatch, caplog):
    monkeypatch.setattr(server, "_FULL_PAUSE_S", 0.01)

    class Poor(socket.socket):
        left = 5

        def accept(self):
            if Poor.left:
                Poor.left -= 1
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            return super().accept()

    listening = Poor(socket.AF_INET, socket.SOCK_STREAM, fileno=address.socket.detach())
    address = dataclasses.replace(address, socket=listening)
    with served(address, PAGE):
        with connect(address):
            until(lambda: not Poor.left)
        assert Guest(address).is_answered()
    said = [record.getMessage() for record in caplog.records if record.name == "jaxscan.web"]
    assert said and set(said) == {"Connections are turned away for now: Too many open files."}


def test_a_thousand_malformed_requests_are_a_few_lines(address):
    said = []
    handler, log = LogLines(said.append), logging.getLogger("aiohttp.server")
    log.addHandler(handler)
    try:
        with served(address, PAGE):
            for n in range(1000):
                with connect(address) as one:
                    one.sendall(f"GET /{n} \x1b[31mHTTP/9\x00\r\n\r\n".encode())
            assert Guest(address).is_answered()
    finally:
        log.removeHandler(handler)
    assert 1 <= len(said) < 10 and all(len(line) < 400 and "\n" not in line for line in said)


def test_messages_of_a_kind_are_collapsed_and_nothing_is_there_for_the_terminal_to_obey(capsys):
    now = [0.0]
    handler = LogLines(say_line, lambda: now[0])

    def log(line, text, *args):
        handler.handle(logging.LogRecord("server", logging.WARNING, "server.py", line, text, args, None))

    for n in range(50):
        log(1, "from %s: \x1b[2Jwiped %d\nnext", "\x9b31m", n)
    log(2, "another kind")
    now[0] = 61.0
    log(1, "again")
    log(1, "again")
    now[0] = 200.0
    log(1, "x" * 5000)
    first, other, later, long = capsys.readouterr().err.splitlines()
    assert first == r"jaxscan: note: from \x9b31m: \x1b[2Jwiped 0 next"
    assert other == "jaxscan: note: another kind"
    assert later == "jaxscan: note: again (49 more of this kind since the last line)"
    assert long.endswith("x (1 more of this kind since the last line)") and len(long) < 400
