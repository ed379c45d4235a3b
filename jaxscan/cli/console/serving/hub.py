"""Pages and their WebSockets: what the slate holds goes out, orders come in."""

import asyncio
import json
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from aiohttp import WSMsgType, web

from jaxscan.cli.console.orders import FOR_ALL, MOST_BYTES, BadOrder, Order, parse_order
from jaxscan.cli.console.outliving import outlived
from jaxscan.cli.console.serving.roles import GRACE_S, KEY, Roles
from jaxscan.cli.console.slate import Slate, as_json
from jaxscan.errors import JaxscanError


MOST_PAGES = 12
_HEARTBEAT_S = 4.0
"""A page that does not answer for half as long is lost."""
_BETWEEN_S = 0.1
"""Between two looks at the slate."""
_GREET_S = 5.0
PICTURE, CLOUD = 1, 2
"""First byte of a binary message."""


class Page(NamedTuple):
    """A page that is open."""

    name: str
    socket: web.WebSocketResponse


class Hub:
    """All open pages."""

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
        """Ends a session whose page is lost: aiming always, others where the operator chose so."""
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
            # It serves nobody, and the laser shines.
            says = "The page that operated is lost: the laser goes off, nobody looks at it."
        elif doing != "nothing" and self._slate.read("lost") == "stop":
            says = "The page that operated is lost: paused after this step, as it was chosen."
        else:
            return
        self._carry_out(Order("pause"))
        self._slate.say(says)
        self._roles.lost_since = None

    async def _greeted(self, socket: web.WebSocketResponse) -> str | None:
        """The page's own name, with which it begins; None if it does not."""
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
                await page.socket.send_str(as_json({"kind": "refused", "says": " ".join(str(problem).split())}))

    def _operates(self, page: Page) -> bool:
        """Whether this is the page that operates; of two with one name, as a copied tab has it, the older one."""
        first = next((one for one in self._pages if one.name == page.name), page)
        return page.name == self._roles.operator and page is first

    async def _send(self, page: Page) -> None:
        """Send what has changed until the page goes; one that cannot be told is closed, and comes again."""
        with outlived(self._slate, "what a page is told"):
            await self._send_changes(page)
        await page.socket.close(code=1011, message=b"the page could not be told; it tries again.")

    async def _send_changes(self, page: Page) -> None:
        """What a slow page missed in between it never gets."""
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
