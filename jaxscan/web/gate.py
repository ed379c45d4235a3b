"""The gate: every request is checked here before anything answers it, WebSockets like pages."""

import secrets
from html import escape
from urllib.parse import urlencode, urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler

from jaxscan.web.address import Address
from jaxscan.web.connections import Connection


_METHODS = {"GET", "HEAD"}
"""Nothing is changed by a request alone: pages ask over their WebSocket."""
_OWN_SITES = {"same-origin", "none"}
"""Values of Sec-Fetch-Site: from our own page, or typed by a person."""
_SECURITY = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'",
    "Cache-Control": "no-store",
}
"""Headers of every response that does not bring its own."""


class Gate:
    """Checks names, origin, site and token of every request to an address."""

    def __init__(self, address: Address) -> None:
        self._address = address
        self._cookie = f"jaxscan-{address.port}"
        """Cookies are shared between the ports of a machine."""
        self._pass = secrets.token_urlsafe()
        """What the cookie holds; the token itself stays in the terminal."""

    def application(self) -> web.Application:
        """An application behind the gate, without any page yet."""

        @web.middleware
        async def let_in(request: web.Request, handler: Handler) -> web.StreamResponse:
            transport = request.transport
            connection = None if transport is None else transport.get_protocol()
            if not isinstance(connection, Connection):
                # It has ended meanwhile.
                return _refused(503, "This connection has ended.")
            connection.begin()
            try:
                known = self._has_pass(request)
                answer = self._refusal(request)
                if answer is None and ("token" in request.query or not known):
                    answer = self._visit(request, known)
                elif answer is None and not connection.welcome():
                    answer = _refused(503, "Too many connections are open; close a page.")
                return await handler(request) if answer is None else answer
            finally:
                connection.end()

        async def secure(request: web.BaseRequest, response: web.StreamResponse) -> None:
            for name, value in _SECURITY.items():
                response.headers.setdefault(name, value)

        application = web.Application(middlewares=[let_in])
        application.on_response_prepare.append(secure)
        return application

    def _refusal(self, request: web.Request) -> web.Response | None:
        """The answer to a request that does not come from a page of ours; None to one that may."""
        if request.method not in _METHODS:
            return _refused(405, "Only GET is answered here.")
        if request.body_exists:
            return _refused(413, "Requests have no body here.")
        hosts = request.headers.getall("Host", [])
        if len(hosts) != 1 or not self._address.knows(_name(hosts[0])):
            return _refused(403, "This name is not one of this machine; open the address that the terminal shows.")
        origins = request.headers.getall("Origin", [])
        if origins and origins != [f"http://{hosts[0]}"]:
            return _refused(403, "Another site asks; open the address that the terminal shows.")
        if not origins and "Upgrade" in request.headers:
            return _refused(403, "A WebSocket without an origin; open the address that the terminal shows.")
        if self._led_here(request) and not self._has_token(request):
            return _refused(403, "Another site leads here; type the address that the terminal shows.")
        return None

    def _has_pass(self, request: web.Request) -> bool:
        return _same(request.cookies.get(self._cookie, ""), self._pass)

    def _has_token(self, request: web.Request) -> bool:
        return _same(request.query.get("token", ""), self._address.token)

    def _led_here(self, request: web.Request) -> bool:
        """Whether the request comes from another site; the local file that opens the browser counts as one."""
        return request.headers.get("Sec-Fetch-Site", "none") not in _OWN_SITES

    def _visit(self, request: web.Request, known: bool) -> web.Response:
        """Trades the token in the address for a cookie, and takes it out of the address."""
        if not known and "token" not in request.query:
            return _refused(403, "Open the whole address that the terminal shows, with its token.")
        if not known and not self._has_token(request):
            return _refused(403, "The token is wrong: open the whole address that the terminal shows.")
        rest = urlencode([(name, value) for name, value in request.query.items() if name != "token"])
        where = "/" + (f"?{rest}" if rest else "")
        if self._led_here(request):
            # After a redirect that began on another site browsers send no strict cookie; so a page of ours forwards the
            # visitor.
            leads = f'<!doctype html><meta http-equiv="refresh" content="0; url={escape(where)}">\n'
            response = web.Response(text=leads, content_type="text/html", charset="utf-8")
        else:
            response = web.Response(status=303, headers={"Location": where})
        response.set_cookie(self._cookie, self._pass, path="/", httponly=True, samesite="Strict")
        return response


def _refused(status: int, why: str) -> web.Response:
    response = web.Response(status=status, text=f"{why}\n")
    # Whoever is refused does not keep a connection.
    response.force_close()
    return response


def _same(given: str, expected: str) -> bool:
    """Compared in a time that does not depend on where they differ."""
    return secrets.compare_digest(given.encode(errors="replace"), expected.encode())


def _name(host: str) -> str:
    """The name in `name:port`; "" where that is not understood."""
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port
    except ValueError:
        return ""
    return (parts.hostname or "") if parts.netloc == host and "@" not in host else ""
