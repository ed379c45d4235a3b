"""The server's end: no connection outlives it."""

import gc
import socket
import time
import warnings

import pytest
from aiohttp import web

from jaxscan.web import open_address

from .asking import let_in, served


MANY = 5


async def much(request):
    return web.Response(body=20_000_000 * b"x")


def end_with_open_connections(asking):
    """The warnings of a server that ends while others are connected, who ask for much and read nothing."""
    address = open_address("127.0.0.1", 0, option="--web-port")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with served(address, web.get("/much", much)):
            others = [socket.create_connection(("127.0.0.1", address.port), timeout=10) for _ in range(MANY)]
            host = f"127.0.0.1:{address.port}"
            if asking:
                cookie = let_in(address.port, address.token)
                for other in others:
                    other.sendall(f"GET /much HTTP/1.1\r\nHost: {host}\r\nCookie: {cookie}\r\n\r\n".encode())
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
