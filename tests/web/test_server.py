"""The server's end: no connection outlives it."""

import gc
import http.client
import socket
import time
import warnings

import pytest
from aiohttp import web

from jaxscan.web import Gate, Server, open_address


MANY = 5


async def much(request):
    return web.Response(body=20_000_000 * b"x")


def cookie(address):
    """That of a guest."""
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=10)
    connection.request("GET", f"/?token={address.token}")
    answer = connection.getresponse()
    connection.close()
    assert answer.status == 303
    return answer.headers["Set-Cookie"].partition(";")[0]


def end_with_open_connections(asking):
    """The warnings of a server that ends while others are connected, who ask for much and read nothing."""
    address = open_address("127.0.0.1", 0, option="--web-port")
    application = Gate(address).application()
    application.add_routes([web.get("/much", much)])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with Server(application, address):
            others = [socket.create_connection(("127.0.0.1", address.port), timeout=10) for _ in range(MANY)]
            host = f"127.0.0.1:{address.port}"
            if asking:
                for other in others:
                    other.sendall(f"GET /much HTTP/1.1\r\nHost: {host}\r\nCookie: {cookie(address)}\r\n\r\n".encode())
                    other.recv(1)
            begun = time.monotonic()
        took = time.monotonic() - begun
        for other in others:
            other.close()
        gc.collect()
    return [str(one.message) for one in said if one.category is ResourceWarning], took


@pytest.mark.more
@pytest.mark.parametrize("asking", [False, True])
def test_no_connection_outlives_the_server(asking):
    # Who connects in the last moment is accepted in time or not: several tries, for it to happen.
    for _ in range(1 if asking else 20):
        said, took = end_with_open_connections(asking)
        assert said == []
        assert took < 10.0
