"""Requests to a server behind the gate, of those who have its token and of strangers."""

import http.client

from aiohttp import web

from jaxscan.web import Gate, Server


PATIENCE_S = 30.0


def served(address, *routes):
    """A server of some routes behind the gate."""
    application = Gate(address).application()
    application.add_routes(routes)
    return Server(application, address)


def page_of(body):
    """A route of a page with nothing else on it."""

    async def page(request):
        return web.Response(body=body)

    return web.get("/", page)


def ask(port, path="/", method="GET", **headers):
    """Status, headers and body of an answer; the path goes as it is, and headers that are None do not go."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in ({"Host": f"127.0.0.1:{port}"} | headers).items():
            if value is not None:
                connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def let_in(port, token):
    """The cookie for which the token is traded."""
    status, headers, _ = ask(port, f"/?token={token}")
    assert status == 303
    return headers["Set-Cookie"].partition(";")[0]
