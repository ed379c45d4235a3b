"""Leads requests on to a server on a loopback port, so that it stands behind the same gate."""

import asyncio
from collections.abc import Iterable

import aiohttp
from aiohttp import web
from yarl import URL


POLICY = (
    "default-src 'self' blob: data:; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' blob: data:; worker-src 'self' blob:; "
    "frame-ancestors 'self'; base-uri 'self'; form-action 'none'"
)
"""Content-Security-Policy of a viewer: its page holds scripts and compiles WebAssembly; nothing from elsewhere."""
MOST_IN = 16 << 20
"""Longest WebSocket message from a browser [bytes]."""
MOST_OUT = 512 << 20
"""Longest WebSocket message to a browser [bytes]: a cloud."""
_PASSED_IN = ("Accept", "Accept-Encoding", "If-None-Match", "If-Modified-Since", "Range", "User-Agent")
"""Headers of a request that are passed on; cookies and tokens stay here."""
_PASSED_OUT = ("Content-Type", "Content-Encoding", "ETag", "Last-Modified", "Content-Range")
_BEGIN_S = 5.0
"""Longest wait for the server behind."""
_Sockets = aiohttp.ClientWebSocketResponse | web.WebSocketResponse


def proxy_routes(prefix: str, port: int) -> Iterable[web.RouteDef]:
    """The routes below a prefix ("" or "/view") to the server at 127.0.0.1 and this port."""
    behind = f"http://127.0.0.1:{port}"

    async def lead_on(request: web.Request) -> web.StreamResponse:
        # As it was sent: what it means is known to the server behind alone.
        path = request.raw_path[len(prefix) :] or "/"
        if not path.startswith("/"):
            path = f"/{path}"
        try:
            if request.headers.get("Upgrade", "").lower() == "websocket":
                return await _lead_socket(request, behind + path)
            return await _lead_page(request, behind + path)
        except (aiohttp.ClientError, TimeoutError):
            return web.Response(status=502, text="The viewer does not answer; begin it again.\n")

    if prefix:
        yield web.get(prefix, lead_on)
    yield web.get(prefix + "/{rest:.*}", lead_on)


async def _lead_page(request: web.Request, url: str) -> web.StreamResponse:
    headers = {name: request.headers[name] for name in _PASSED_IN if name in request.headers}
    limits = aiohttp.ClientTimeout(connect=_BEGIN_S)
    async with (
        aiohttp.ClientSession(timeout=limits, auto_decompress=False) as session,
        session.request(request.method, _exact(url), headers=headers, allow_redirects=False) as answer,
    ):
        response = web.StreamResponse(status=answer.status, headers={"Content-Security-Policy": POLICY})
        for name in _PASSED_OUT:
            if name in answer.headers:
                response.headers[name] = answer.headers[name]
        await response.prepare(request)
        async for data in answer.content.iter_chunked(1 << 16):
            await response.write(data)
        await response.write_eof()
        return response


async def _lead_socket(request: web.Request, url: str) -> web.StreamResponse:
    said = request.headers.get("Sec-WebSocket-Protocol", "")
    protocols = [word.strip() for word in said.split(",") if word.strip()]
    limits = aiohttp.ClientTimeout(connect=_BEGIN_S)
    async with (
        aiohttp.ClientSession(timeout=limits) as session,
        session.ws_connect(_exact(url), protocols=protocols, max_msg_size=MOST_OUT) as inner,
    ):
        chosen = [inner.protocol] if inner.protocol else []
        outer = web.WebSocketResponse(protocols=chosen, max_msg_size=MOST_IN, compress=False)
        await outer.prepare(request)
        ways = [asyncio.create_task(_carry(outer, inner)), asyncio.create_task(_carry(inner, outer))]
        try:
            # Either end that closes ends both.
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            await outer.close()
        return outer


async def _carry(come: _Sockets, go: _Sockets) -> None:
    async for message in come:
        if message.type is aiohttp.WSMsgType.TEXT:
            await go.send_str(message.data)
        elif message.type is aiohttp.WSMsgType.BINARY:
            await go.send_bytes(message.data)


def _exact(url: str) -> URL:
    return URL(url, encoded=True)
