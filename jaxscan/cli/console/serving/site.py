"""The console's addresses: its page, its socket, pictures of captures, their clouds, and the viewer."""

import asyncio
import os
from collections.abc import Callable

from aiohttp import web
from aiohttp.typedefs import Handler

from jaxscan.cli.console.captures import MADE
from jaxscan.cli.console.desk import Desk
from jaxscan.cli.console.orders import Order
from jaxscan.cli.console.serving.hub import Hub
from jaxscan.cli.console.serving.looks import Looks
from jaxscan.cli.console.sessions import Sessions
from jaxscan.errors import JaxscanError
from jaxscan.viewer import view_routes
from jaxscan.web import Address, Gate, Resource, resource_routes


_PACKAGE = "jaxscan.cli.console"
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
_FILES = (
    "index.html",
    "style.css",
    "main.js",
    "dom.js",
    "live.js",
    "guide.js",
    "cloud.js",
    "captures.js",
    "hand.js",
    "icon.svg",
)
_JPEG, _BINARY = "image/jpeg", "application/octet-stream"


def make_site(address: Address, desk: Desk, sessions: Sessions) -> web.Application:
    """The application of the console, behind the gate."""

    def carry_out(order: Order) -> None:
        match order.do:
            case "lost":
                desk.slate.write(lost="stop" if order.stop else "go on")
            case "calibrate":
                sessions.calibrate(order.name)
            case "reconstruct":
                sessions.reconstruct(order.name)
            case "compare":
                sessions.compare(order.name, order.other)
            case "use":
                sessions.use(order.name)
            case "recalibrate":
                sessions.recalibrate(order.name)
            case "plan":
                sessions.draw_plan(order.name)
            case "mesh":
                sessions.make_mesh(order.name)
            case "report":
                sessions.report(order.name)
            case "delete":
                sessions.delete(order.name)
            case "rename":
                sessions.rename(order.name, order.other)
            case _:
                desk.ask(order)

    hub = Hub(desk.slate, carry_out)
    captures = desk.captures

    def photograph(request: web.Request) -> bytes:
        asked, query = request.match_info, request.query
        return captures.photograph(asked["name"], int(asked["index"]), lit="lit" in query, small="small" in query)

    async def made(request: web.Request) -> web.StreamResponse:
        """A file that was made of a capture, to be kept: a page of ours does not show it."""
        try:
            path = captures.made(request.match_info["name"], request.match_info["what"])
        except JaxscanError as problem:
            return web.Response(status=404, text=f"{problem}\n")
        if os.path.islink(path) or not os.path.isfile(path):
            return web.Response(status=404, text="it was not made yet.\n")
        headers = {"Content-Disposition": f'attachment; filename="{path.name}"', "Content-Type": _BINARY}
        return web.FileResponse(path, headers=headers)

    site = Gate(address).application()
    listed = {f"/{name}": Resource(_PACKAGE, f"page/{name}", _type(name)) for name in _FILES}
    listed["/"] = listed.pop("/index.html")
    site.add_routes(resource_routes(listed))
    site.add_routes(
        [
            web.get("/socket", hub.socket),
            web.get(r"/pictures/{name}/{index:\d{1,7}}", _answer(photograph, _JPEG)),
            web.get(f"/made/{{name}}/{{what:{'|'.join(MADE)}}}", made),
            web.get("/clouds/{name}", _answer(lambda request: captures.points(request.match_info["name"]), _BINARY)),
        ]
    )
    site.add_routes(view_routes("/look/{name}", Looks(captures).view))
    site.on_shutdown.append(hub.close)
    site.cleanup_ctx.append(hub.watch)
    return site


def _type(name: str) -> str:
    return f"{_TYPES[name.rpartition('.')[2]]}; charset=utf-8"


def _answer(make: Callable[[web.Request], bytes], content_type: str) -> Handler:
    """Answers with bytes that a thread makes, or with the line why it cannot."""

    async def answer(request: web.Request) -> web.StreamResponse:
        try:
            body = await asyncio.to_thread(make, request)
        except JaxscanError as problem:
            return web.Response(status=404, text=" ".join(str(problem).split()) + "\n")
        return web.Response(body=body, content_type=content_type)

    return answer
