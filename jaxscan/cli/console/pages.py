"""The console for browsers: its addresses, its sockets, who operates, and the viewer for finished clouds."""

import asyncio
import json
import os
import re
import struct
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from aiohttp import WSMsgType, web
from aiohttp.typedefs import Handler

from jaxscan import api
from jaxscan.cli.console.captures import MADE, Captures
from jaxscan.cli.console.desk import Desk
from jaxscan.cli.console.orders import FOR_ALL, MOST_BYTES, BadOrder, Order, parse_order
from jaxscan.cli.console.slate import Slate, as_json, one_line, outlived
from jaxscan.cli.console.works import ORDERS, Works
from jaxscan.errors import CloudError, JaxscanError
from jaxscan.viewer import Named, View, view_routes
from jaxscan.web import Address, Gate, page_routes


_JPEG, _BINARY = "image/jpeg", "application/octet-stream"


def make_site(address: Address, desk: Desk, works: Works, captures: Captures) -> web.Application:
    """The application of the console, behind the gate."""

    def carry_out(order: Order) -> None:
        if order.do == "lost":
            desk.slate.write(lost="stop" if order.stop else "go on")
        elif order.do in ORDERS:
            works.carry_out(order)
        else:
            desk.ask(order)

    def photograph(request: web.Request) -> bytes:
        asked, query = request.match_info, request.query
        return captures.photograph(asked["name"], int(asked["index"]), lit="lit" in query, small="small" in query)

    async def made(request: web.Request) -> web.StreamResponse:
        """A file that was made of a capture, as a download."""
        try:
            path = captures.made(request.match_info["name"], request.match_info["what"])
        except JaxscanError as problem:
            return web.Response(status=404, text=f"{problem}\n")
        if os.path.islink(path) or not os.path.isfile(path):
            return web.Response(status=404, text="it was not made yet.\n")
        headers = {"Content-Disposition": f'attachment; filename="{path.name}"', "Content-Type": _BINARY}
        return web.FileResponse(path, headers=headers)

    hub = Hub(desk.slate, carry_out)
    site = Gate(address).application()
    site.add_routes(page_routes("jaxscan.cli.console"))
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


def _answer(make: Callable[[web.Request], bytes], content_type: str) -> Handler:
    """Answers with bytes that a thread makes, or with the line why it cannot."""

    async def answer(request: web.Request) -> web.StreamResponse:
        try:
            body = await asyncio.to_thread(make, request)
        except JaxscanError as problem:
            return web.Response(status=404, text=one_line(problem) + "\n")
        return web.Response(body=body, content_type=content_type)

    return answer


KEY = re.compile(r"[0-9a-f]{32}")
"""A page's own name, which it keeps over a reload."""
GRACE_S = 4.0
"""The operating page may be gone for so long, as during a reload [s]."""


@dataclass
class Roles:
    """Which of several pages operates; the others watch. A page that comes back under its name keeps its role."""

    operator: str = ""
    """Name of the page that operates; "" before the first came."""
    lost_since: float | None = None
    """When the operating page went; None while it is there, or before one came."""
    _there: list[str] = field(default_factory=list)

    def join(self, name: str, now: float) -> None:
        """A page came; it operates if there is no operating page, and none that may soon come back from a reload."""
        self._there.append(name)
        if self.operator not in self._there and (self.lost_since is None or self.lost_for(now) > GRACE_S):
            self.operator = name
        if name == self.operator:
            self.lost_since = None

    def leave(self, name: str, now: float) -> None:
        """A page went."""
        self._there.remove(name)
        if name == self.operator and name not in self._there:
            self.lost_since = now

    def take_over(self, name: str) -> None:
        """A page that is there operates from now on."""
        self.operator, self.lost_since = name, None

    def lost_for(self, now: float) -> float:
        """How long the operating page is gone [s]."""
        return 0.0 if self.lost_since is None else now - self.lost_since


MOST_PAGES = 12
_HEARTBEAT_S = 4.0
"""Time between pings [s]; a page that does not answer within half of it counts as lost."""
_BETWEEN_S = 0.1
_GREET_S = 5.0
PICTURE, CLOUD = 1, 2


class Page(NamedTuple):
    """A page that is open."""

    name: str
    socket: web.WebSocketResponse


class Hub:
    """All open pages: what the slate holds goes out, orders come in."""

    def __init__(self, slate: Slate, carry_out: Callable[[Order], None]) -> None:
        """`carry_out` passes an order on; it raises JaxscanError where it cannot be carried out."""
        self._slate, self._carry_out = slate, carry_out
        self._roles = Roles()
        self._pages: list[Page] = []
        self._not_greeted = 0
        """Sockets whose page has not said its name yet."""

    async def socket(self, request: web.Request) -> web.WebSocketResponse:
        """Serve one page until it goes."""
        socket = web.WebSocketResponse(heartbeat=_HEARTBEAT_S, max_msg_size=MOST_BYTES, compress=False)
        await socket.prepare(request)
        if len(self._pages) + self._not_greeted >= MOST_PAGES:
            await socket.close(code=1008, message=b"too many pages are open; close one.")
            return socket
        self._not_greeted += 1
        try:
            name = await self._greeted(socket)
        finally:
            self._not_greeted -= 1
        if name is None:
            await socket.close(code=1008, message=b"load the page again.")
            return socket
        page = Page(name, socket)
        self._pages.append(page)
        self._roles.join(name, time.monotonic())
        sender = asyncio.create_task(self._send(page))
        try:
            async for message in socket:
                if message.type is not WSMsgType.TEXT:
                    break
                await self._hear(page, message.data)
        finally:
            sender.cancel()
            self._pages.remove(page)
            self._roles.leave(name, time.monotonic())
        return socket

    async def watch(self, application: web.Application) -> Any:
        """Ends a session whose page is lost: aiming always, a scan if the operator chose so."""
        task = asyncio.create_task(self._watch())
        yield
        task.cancel()
        await asyncio.wait([task])

    async def close(self, application: web.Application) -> None:
        """Tell all pages that the console ends."""
        for page in list(self._pages):
            await page.socket.close(code=1001, message=b"The console has ended; begin it again.")

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(_BETWEEN_S)
            with outlived(self._slate, "the watch over pages"):
                self._look_for_lost_page()

    def _look_for_lost_page(self) -> None:
        if self._roles.lost_for(time.monotonic()) <= GRACE_S:
            return
        doing = self._slate.read("doing")
        if doing == "aim":
            # Aiming without a page serves nobody, and the laser is on.
            says = "The page that operated is lost: the laser goes off, nobody looks at it."
        elif doing != "nothing" and self._slate.read("lost") == "stop":
            says = "The page that operated is lost: paused after this step, as it was chosen."
        else:
            return
        self._carry_out(Order("pause"))
        self._slate.say(says)
        self._roles.lost_since = None

    async def _greeted(self, socket: web.WebSocketResponse) -> str | None:
        """The page's own name, which its first message holds; None if that message is something else."""
        try:
            found = json.loads(await asyncio.wait_for(socket.receive_str(), _GREET_S))
        except (TypeError, ValueError, TimeoutError, RecursionError):
            return None
        name = found.get("page") if isinstance(found, dict) else None
        return name if isinstance(name, str) and KEY.fullmatch(name) else None

    async def _hear(self, page: Page, text: str) -> None:
        try:
            order = parse_order(text)
            if order.do == "take over":
                self._roles.take_over(page.name)
            elif order.do not in FOR_ALL and not self._operates(page):
                raise BadOrder("another page operates: take over first.")
            else:
                self._carry_out(order)
        except JaxscanError as problem:
            # The page may be gone by now.
            with suppress(ConnectionError):
                await page.socket.send_str(as_json({"kind": "refused", "says": one_line(problem)}))

    def _operates(self, page: Page) -> bool:
        """Whether this is the page that operates; of two with one name, as a copied tab has it, the older one."""
        first = next((one for one in self._pages if one.name == page.name), page)
        return page.name == self._roles.operator and page is first

    async def _send(self, page: Page) -> None:
        """Send changes until the page goes. A page that takes none is closed, and connects again."""
        with outlived(self._slate, "what a page is told"):
            await self._send_changes(page)
        await page.socket.close(code=1011, message=b"the page could not be told; it tries again.")

    async def _send_changes(self, page: Page) -> None:
        """A slow page skips the states in between."""
        state = picture = cloud = chunks = 0
        you: dict[str, Any] = {}
        try:
            while True:
                state, fields = self._slate.state(state)
                now = {"operates": self._operates(page), "pages": len(self._pages)}
                if fields is not None or now != you:
                    you = now
                    state, fields = self._slate.state(0)
                    await page.socket.send_str(as_json({"kind": "state", "state": fields, "you": you}))
                shown = self._slate.picture()
                if shown.version != picture:
                    picture = shown.version
                    await page.socket.send_bytes(bytes([PICTURE]) + shown.jpeg)
                number, new = self._slate.cloud(cloud, chunks)
                if number != cloud:
                    cloud, chunks = number, 0
                for chunk in new:
                    chunks += 1
                    await page.socket.send_bytes(struct.pack("<BxxxI", CLOUD, number) + chunk)
                await asyncio.sleep(_BETWEEN_S)
        except ConnectionError:
            # The page is gone; its socket ends too.
            return


MOST_CLOUDS = 3


class Looks:
    """The clouds that people look at; the last few are held, with what was measured in them."""

    def __init__(self, captures: Captures) -> None:
        """No cloud is read yet."""
        self._captures = captures
        self._views: OrderedDict[tuple[str, int], View] = OrderedDict()
        self._reading = asyncio.Lock()

    async def view(self, request: web.Request) -> View:
        """The view of the cloud whose capture is in the address.

        Raises:
            CloudError: If there is no cloud, or it has no points.
        """
        name = request.match_info["name"]
        async with self._reading:
            path = self._captures.cloud(name)
            try:
                # A cloud that was reconstructed again replaces the one in memory.
                state = name, os.stat(path).st_mtime_ns
            except OSError as problem:
                raise CloudError(f"{name}: has no cloud yet; reconstruct it first.") from problem
            if state not in self._views:
                while len(self._views) >= MOST_CLOUDS:
                    self._views.popitem(last=False)
                self._views[state] = await asyncio.to_thread(self._read, name)
            self._views.move_to_end(state)
            return self._views[state]

    def _read(self, name: str) -> View:
        path = self._captures.cloud(name)
        stored = api.read_cloud(path)
        if not stored.cloud.valid.any():
            raise CloudError(f"{path}: has no points; nothing can be shown.")
        file = self._captures.calibration_of(stored.about.calibration)
        return View([Named(str(path), stored.cloud)], None if file is None else api.load_scanner(file))
