"""The gate of pages: names, origins, sites, tokens, paths and sizes, over real sockets."""

import asyncio
import socket

import aiohttp
import pytest
from aiohttp import web

from jaxscan.errors import OptionError
from jaxscan.web import PAGE_POLICY, open_address, page_routes

from . import asking
from .asking import let_in, served


MOST = 1000
"""Longest message that the echo takes [bytes]."""
_COOKIES = {}


async def echo(request):
    answering = web.WebSocketResponse(max_msg_size=MOST)
    await answering.prepare(request)
    async for message in answering:
        await answering.send_str(f"heard {message.data}")
    return answering


@pytest.fixture
def narrow():
    address = open_address("127.0.0.1", 0, option="--web-port")
    with served(address, *page_routes("jaxscan.viewer"), web.get("/echo", echo)):
        yield address


@pytest.fixture
def wide():
    address = open_address("0.0.0.0", 0, option="--web-port")
    with served(address, *page_routes("jaxscan.viewer"), web.get("/echo", echo)):
        yield address


def guest(address):
    """The cookie of somebody who has shown the token."""
    if address.token not in _COOKIES:
        _COOKIES[address.token] = let_in(address.port, address.token)
    return _COOKIES[address.token]


def ask(address, path="/", method="GET", **headers):
    """The answer to a guest's request; a stranger is who gives None for the cookie."""
    headers = {"Cookie": guest(address)} | headers if "Cookie" not in headers else headers
    return asking.ask(address.port, path, method, **headers)


def talk(address, work, **headers):
    """What `work` returns with a WebSocket that a guest opened with these headers."""
    headers = {"Cookie": guest(address)} | headers if "Cookie" not in headers else headers

    async def go():
        given = {"Origin": f"http://127.0.0.1:{address.port}"} | {
            name.replace("_", "-"): value for name, value in headers.items()
        }
        given = {name: value for name, value in given.items() if value is not None}
        url = f"http://127.0.0.1:{address.port}/echo"
        async with aiohttp.ClientSession() as session, session.ws_connect(url, headers=given) as opened:
            return await work(opened)

    return asyncio.run(go())


async def say_hello(opened):
    await opened.send_str("hello")
    return (await opened.receive(10)).data


def refused(address, **headers):
    """The status with which a WebSocket is refused."""
    with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
        talk(address, say_hello, **headers)
    return refusal.value.status


def test_a_page_and_a_socket_on_the_loopback(narrow):
    status, headers, body = ask(narrow)
    assert (
        status == 200 and body.startswith(b"<!doctype html>") and headers["Content-Type"] == "text/html; charset=utf-8"
    )
    assert headers["Content-Security-Policy"] == PAGE_POLICY
    assert headers["X-Content-Type-Options"] == "nosniff" and headers["Cache-Control"] == "no-store"
    assert narrow.url() == f"http://127.0.0.1:{narrow.port}/"
    assert talk(narrow, say_hello) == "heard hello"


@pytest.mark.parametrize("name", ["localhost", "LOCALHOST", "[::1]"])
def test_other_names_of_the_loopback_and_another_port_as_of_a_tunnel(narrow, name):
    assert ask(narrow, Host=f"{name}:9000", Origin=f"http://{name}:9000")[0] == 200


FOREIGN_HOSTS = [
    "evil.example",
    "127.0.0.1.evil.example",
    "evil.example#127.0.0.1",
    "evil.example@127.0.0.1",
    "127.0.0.1@evil.example",
    "192.168.1.5",
    "127.0.0.1:x",
    "[::1",
    "",
    None,
]


@pytest.mark.parametrize("host", FOREIGN_HOSTS)
def test_a_foreign_name_is_refused_on_the_loopback_too(narrow, host):
    status, headers, body = ask(narrow, Host=host)
    assert status in (400, 403) and b"html" not in body
    assert "Set-Cookie" not in headers


def test_two_names_are_refused(narrow):
    with socket.create_connection(("127.0.0.1", narrow.port), timeout=10) as plain:
        plain.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n")
        answer = b"".join(iter(lambda: plain.recv(4096), b""))
    assert answer.split()[1] in (b"400", b"403")


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "http://127.0.0.1:1",
        "http://127.0.0.1",
        "file://",
        "",
        "http://[",
        "ftp://{host}",
        "https://{host}",
        "http://{host}/",
        "http://{host}/a",
        "HTTP://{host}",
        "http://{host} http://{host}",
    ],
)
def test_a_foreign_origin_is_refused_for_pages_and_sockets(narrow, origin):
    origin = origin.format(host=f"127.0.0.1:{narrow.port}")
    assert ask(narrow, Origin=origin)[0] == 403
    assert refused(narrow, Origin=origin) == 403


def test_a_socket_needs_an_origin(narrow):
    assert refused(narrow, Origin=None) == 403


@pytest.mark.parametrize("site", ["cross-site", "same-site", "anything"])
def test_another_site_may_not_lead_here(narrow, site):
    assert ask(narrow, Sec_Fetch_Site=site)[0] == 403
    assert refused(narrow, Sec_Fetch_Site=site) == 403


@pytest.mark.parametrize("site", ["same-origin", "none"])
def test_our_own_page_and_a_typed_address_may(narrow, site):
    assert ask(narrow, Sec_Fetch_Site=site)[0] == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "TRACE"])
def test_nothing_but_get_is_answered(narrow, method):
    assert ask(narrow, method=method)[0] == 405


PATHS = [
    "/../pyproject.toml",
    "/..%2f..%2fpyproject.toml",
    "/%2e%2e/%2e%2e/etc/passwd",
    "/..\\..\\pyproject.toml",
    "//etc/passwd",
    "/./demo.toml",
    "/demo.toml",
    "/data/",
    "/echo/../../jaxscan",
    "/%00",
    "/" + 5000 * "a",
]


@pytest.mark.parametrize("path", PATHS, ids=range(len(PATHS)))
def test_there_is_no_folder_to_walk(narrow, path):
    status, _, body = ask(narrow, path)
    assert status in (400, 404) and len(body) < 200 and b"root:" not in body


def test_a_header_that_is_too_long_is_refused(narrow):
    assert ask(narrow, Cookie=20_000 * "a")[0] == 400


def test_a_message_that_is_too_long_closes_its_socket_and_no_other(narrow):
    async def shout(opened):
        await opened.send_str((MOST + 1) * "a")
        return (await opened.receive(10)).type, opened.close_code

    assert talk(narrow, shout) == (aiohttp.WSMsgType.CLOSE, aiohttp.WSCloseCode.MESSAGE_TOO_BIG)
    assert talk(narrow, say_hello) == "heard hello"


@pytest.fixture(params=["narrow", "wide"])
def either(request):
    return request.getfixturevalue(request.param)


def test_an_address_needs_its_token(either):
    assert len(either.token) > 30 and either.url(with_token=True).endswith(f"/?token={either.token}")
    assert either.token not in either.url()
    for path in (
        "/",
        "/echo",
        "/nothing",
        "/?token=",
        f"/?token={either.token[:-1]}",
        "/?token=%ff%fe",
        "/?token=%c3%a9",
        "/?token=%c3%a9",
    ):
        status, headers, _ = ask(either, path, Cookie=None)
        assert status in (400, 403) and "Set-Cookie" not in headers
    assert refused(either, Cookie=None) == 403
    assert refused(either, Cookie=f"jaxscan-{either.port}={either.token}") == 403


def test_the_token_is_traded_for_a_cookie_and_leaves_the_address(either):
    status, headers, _ = ask(either, f"/?token={either.token}&page=2", Cookie=None)
    assert (status, headers["Location"]) == (303, "/?page=2")
    cookie, *flags = headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(flags)
    assert either.token not in cookie
    assert ask(either, Cookie=cookie)[0] == 200
    assert talk(either, say_hello, Cookie=cookie) == "heard hello"
    # The cookie does not open the gate to another site.
    assert ask(either, Cookie=cookie, Origin="http://evil.example")[0] == 403
    assert refused(either, Cookie=cookie, Origin="http://evil.example") == 403
    assert ask(either, Cookie=cookie, Host="evil.example")[0] == 403
    assert ask(either, Cookie=cookie + "x")[0] == 403


def test_a_guest_that_brings_the_token_has_it_taken_out_of_the_address(either):
    for token in (either.token, "of_another_day"):
        status, headers, _ = ask(either, f"/?token={token}&page=2")
        assert (status, headers["Location"]) == (303, "/?page=2")


def test_the_file_with_which_a_browser_is_opened_leads_in_by_the_token_alone(either):
    status, headers, body = ask(either, f'/?token={either.token}&page="><b>', Cookie=None, Sec_Fetch_Site="cross-site")
    assert status == 200 and headers["Set-Cookie"].startswith(f"jaxscan-{either.port}=")
    assert b'content="0; url=/?page=%22%3E%3Cb%3E"' in body and either.token.encode() not in body
    for token in ("", "?token=", "?token=wrong"):
        status, headers, _ = ask(either, f"/{token}", Cookie=None, Sec_Fetch_Site="cross-site")
        assert status == 403 and "Set-Cookie" not in headers


def test_a_token_goes_nowhere_else(wide):
    status, headers, _ = ask(wide, f"//evil.example/?token={wide.token}", Cookie=None)
    assert (status, headers["Location"]) == (303, "/")


def test_a_wide_address_knows_its_numbers_and_its_own_name(wide):
    own = socket.gethostname()
    for host in ("192.168.1.5:80", f"{own}:80", f"{own}.local:80"):
        assert ask(wide, f"/?token={wide.token}", Host=host, Cookie=None)[0] == 303
    assert ask(wide, f"/?token={wide.token}", Host="evil.example", Cookie=None)[0] == 403


def test_a_port_that_is_taken_is_said_in_one_line(narrow):
    with pytest.raises(OptionError, match=r"--web-port: the port \d+ is taken by another program; choose another"):
        open_address("127.0.0.1", narrow.port, option="--web-port")


@pytest.mark.parametrize("host", ["198.51.100.7", "no such machine.invalid", "a" * 300])
def test_a_host_that_is_not_here_is_said_in_one_line(host):
    with pytest.raises(OptionError, match="--host: found") as problem:
        open_address(host, 0, option="--web-port")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none(port):
    with pytest.raises(OptionError, match=r"expected 0 \.\.\. 65535"):
        open_address("127.0.0.1", port, option="--web-port")
