"""The viewer's addresses: its page, the points and their colours in chunks, and a socket for measurements."""

import asyncio
import json
import re
import secrets
from collections import Counter, OrderedDict
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from aiohttp import WSMsgType, web
from aiohttp.typedefs import Handler

from jaxscan.errors import JaxscanError, OptionError
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import PointCloud
from jaxscan.viewer.colours import COLOURINGS, Scale
from jaxscan.viewer.orders import MOST_BYTES, Order, parse_order
from jaxscan.viewer.session import Session, Work, inside_section
from jaxscan.viewer.shown import ShownCloud, Surface, has_grid, middle_of, surface_bytes, surface_of
from jaxscan.web import Address, Gate, Server, page_routes


AT_ONCE = 2
"""Most measurements in progress, of all pages together and including cancelled ones."""
_HEARTBEAT_S = 10.0
_MOST_SESSIONS = 12
_MOST_STATIONS = 50
_MOST_PRODUCTS = 500
_URGENT = ("failed", "stale", "missing", "done")
_NUMBER = re.compile(r"[0-9]{1,6}")
_KEPT = 2

Products = Callable[[], Sequence[tuple[str, str, str]]]
"""The products of a project as they are now: name, state, and why."""


class Panorama(NamedTuple):
    """An equirectangular picture of a whole turn from the first station, the scanner's x axis in its middle.

    Its upper and its lower edge are elevations [rad].
    """

    jpeg: bytes
    top: float
    bottom: float


class Named(NamedTuple):
    """A cloud to show."""

    name: str
    cloud: PointCloud
    """The cloud in metres, z up, with at least one valid point."""
    turned: bool = False
    """Whether the axes differ from those of the file."""
    words: Mapping[str, str] = MappingProxyType({})
    """Options with which `jaxscan measure` gives the same results: "calibration", "unit" and "up"."""
    panorama: Panorama | None = None


def serve_clouds(
    address: Address, clouds: Sequence[Named], scanner: Scanner | None = None, products: Products | None = None
) -> AbstractContextManager[Server]:
    """Show clouds at an address, within `with`.

    Args:
        address: Where to listen.
        clouds: One or more.
        scanner: The rig that took the clouds; sigma then includes the part of its calibration.
        products: Gives the products of their project, which are listed beside them.
    """
    view = View(clouds, scanner, products)

    async def only(_: web.Request) -> View:
        return view

    application = Gate(address).application()
    application.add_routes(view_routes("", only))
    return Server(application, address)


def view_routes(prefix: str, find: Callable[[web.Request], Awaitable["View"]]) -> Iterable[web.RouteDef]:
    """The addresses of the viewer below a prefix, which may have names in braces, for an application behind a gate.

    `find` gives the clouds that a request asks for; it raises JaxscanError where there are none.
    """
    yield from page_routes("jaxscan.viewer", prefix)
    chunk = r"{part:\d{1,3}}/{chunk:\d{1,6}}"
    answers: dict[str, Callable[[View, web.Request], Awaitable[web.StreamResponse]]] = {
        "/scene": View.scene,
        f"/points/{chunk}": View.points,
        f"/colours/{chunk}": View.coloured,
        r"/surface/{part:\d{1,3}}": View.surface,
        r"/surface-colours/{part:\d{1,3}}": View.surface_coloured,
        "/cut": View.cut,
        r"/panorama/{part:\d{1,3}}": View.panorama,
        "/scale": View.scale,
        "/products": View.products,
        "/socket": View.socket,
    }
    for path, answer in answers.items():
        yield web.get(prefix + path, _answer(find, answer))


class View:
    """Clouds as pages show them, and what pages measure in them."""

    def __init__(
        self, clouds: Sequence[Named], scanner: Scanner | None = None, products: Products | None = None
    ) -> None:
        """Sort the points; arguments as of `serve_clouds`."""
        self.clouds = [
            ShownCloud(one.name, one.cloud, middle_of(one.cloud), turned=one.turned, words=one.words) for one in clouds
        ]
        self._id = secrets.token_hex(8)
        """Tells a page that its server was restarted, perhaps with other clouds."""
        self._panoramas, self._scanner = [one.panorama for one in clouds], scanner
        self._products, self._looking = products, asyncio.Lock()
        self._sessions: OrderedDict[str, Session] = OrderedDict()
        self._colours: OrderedDict[tuple[Any, ...], tuple[list[np.ndarray], Scale | None]] = OrderedDict()
        self._colouring = asyncio.Lock()
        self._slots = asyncio.Semaphore(AT_ONCE)
        self._surfaces: dict[int, Surface] = {}
        self._joining = asyncio.Lock()

    async def scene(self, _: web.Request) -> web.Response:
        """All that a page can show: clouds with the lists of their chunks, places to stand in, colourings."""
        clouds = [
            {
                "name": cloud.name,
                "points": cloud.points,
                # Infinity is no JSON.
                "chunks": [
                    [c.tile, c.stop - c.start, *c.centre.tolist(), c.radius, min(c.gap, 1e9), c.spacing]
                    for c in cloud.levels.chunks
                ],
                # Place of the cloud in the scene, whose origin is that of the first cloud.
                "shift": (cloud.origin - self.clouds[0].origin).tolist(),
                "stations": cloud.stations()[:_MOST_STATIONS].tolist(),
                "low": cloud.low.tolist(),
                "high": cloud.high.tolist(),
                "sides": cloud.sides is not None,
                "hides": cloud.hides,
                "walls": cloud.walls,
                "surface": has_grid(cloud),
                "panorama": None if seen is None else {"top": seen.top, "bottom": seen.bottom, "axes": cloud.axes()},
            }
            for cloud, seen in zip(self.clouds, self._panoramas, strict=True)
        ]
        known = [by for by in COLOURINGS if any(cloud.has(by) for cloud in self.clouds)]
        # A page begins with the first colouring. A panorama belongs to the colouring by photographs.
        if any(self._panoramas) and "photograph" not in known:
            known.insert(0, "photograph")
        said = {"id": self._id, "systematic": self._scanner is not None, "products": self._products is not None}
        return _json({"clouds": clouds, "colourings": known, **said})

    async def points(self, request: web.Request) -> web.StreamResponse:
        """Places of a chunk about its middle, float32; and their sides, int8, where the cloud knows them."""
        cloud, chunk = self._asked(request)
        part, middle = slice(chunk.start, chunk.stop), chunk.centre.astype(np.float32)
        body = np.ascontiguousarray(cloud.xyz[part] - middle).tobytes()
        return web.Response(
            body=body + (b"" if cloud.sides is None else cloud.sides[part].tobytes()), content_type=_BINARY
        )

    async def coloured(self, request: web.Request) -> web.Response:
        """Colours of a chunk, uint8."""
        _, chunk = self._asked(request)
        colours, _ = await self._by(request)
        number = int(request.match_info["part"])
        return web.Response(body=colours[number][chunk.start : chunk.stop].tobytes(), content_type=_BINARY)

    async def surface(self, request: web.Request) -> web.Response:
        """The triangles of a cloud, packed by `surface_bytes`."""
        cloud, surface = await self._surface(request)
        return web.Response(body=await asyncio.to_thread(surface_bytes, cloud, surface), content_type=_BINARY)

    async def surface_coloured(self, request: web.Request) -> web.Response:
        """Colours of the corners of these triangles, uint8."""
        _, surface = await self._surface(request)
        colours, _ = await self._by(request)
        body = colours[int(request.match_info["part"])][surface.points].tobytes()
        return web.Response(body=body, content_type=_BINARY)

    async def _surface(self, request: web.Request) -> tuple[ShownCloud, Surface]:
        number = int(request.match_info["part"])
        if number >= len(self.clouds):
            raise OptionError("there is no such cloud.")
        async with self._joining:
            if number not in self._surfaces:
                self._surfaces[number] = await asyncio.to_thread(surface_of, self.clouds[number])
        return self.clouds[number], self._surfaces[number]

    async def cut(self, request: web.Request) -> web.Response:
        """The points in the section of an order, as a PLY file in the frame of the first cloud."""
        order = parse_order(request.query.get("order", ""), len(self.clouds))
        if order.do != "cut":
            raise OptionError("no such order.")
        body = await asyncio.to_thread(self._cut, order)
        headers = {"Content-Disposition": 'attachment; filename="section.ply"'}
        return web.Response(body=body, content_type=_BINARY, headers=headers)

    def _cut(self, order: Order) -> bytes:
        found = []
        for number, shift in order.shifts:
            cloud = self.clouds[number]
            inside = inside_section(cloud, shift, order)
            part = np.zeros(np.count_nonzero(inside), [("xyz", "<f8", 3), ("rgb", "u1", 3)])
            part["xyz"] = cloud.xyz[inside] + (shift + self.clouds[0].origin)
            part["rgb"] = cloud.take(cloud.cloud.rgb)[inside]
            found.append(part)
        rows = np.concatenate(found) if found else np.zeros(0)
        if not len(rows):
            raise OptionError("There are no points in the section.")
        fields = [f"property double {x}" for x in "xyz"] + [f"property uchar {x}" for x in ("red", "green", "blue")]
        head = ["ply", "format binary_little_endian 1.0", "comment metres", f"element vertex {len(rows)}", *fields]
        return "\n".join([*head, "end_header\n"]).encode() + rows.tobytes()

    async def panorama(self, request: web.Request) -> web.Response:
        """The panorama of a cloud, JPEG."""
        number, known = int(request.match_info["part"]), dict(enumerate(self._panoramas))
        if (seen := known.get(number)) is None:
            raise OptionError("there is no such panorama.")
        return web.Response(body=seen.jpeg, content_type="image/jpeg")

    async def scale(self, request: web.Request) -> web.Response:
        """The scale of the colours; null for the colours of things."""
        _, scale = await self._by(request)
        if scale is None:
            return _json(None)
        bar = scale.coloured(np.linspace(scale.low, scale.high, 32))
        return _json({"words": scale.words(), "bar": bar.tolist(), "diverging": scale.diverging})

    async def products(self, _: web.Request) -> web.Response:
        """The products of the project as they are now; those that need attention come first."""
        if self._products is None:
            raise OptionError("there is no project.")
        async with self._looking:
            rows = await asyncio.to_thread(self._products)
        counts = Counter(state for _, state, _ in rows)
        rows = sorted(rows, key=lambda row: _URGENT.index(row[1]))[:_MOST_PRODUCTS]
        return _json({"counts": counts, "rows": rows})

    async def _by(self, request: web.Request) -> tuple[list[np.ndarray], Scale | None]:
        """The colours that a request asks for, of all clouds; they are made once."""
        by = next((one for one in COLOURINGS if one == request.query.get("by")), None)
        if by is None:
            raise OptionError("no such colours.")
        plane = None
        if by == "deviation":
            session, number = self._sessions.get(request.query.get("page", "")), request.query.get("plane", "")
            plane = session.plane(int(number)) if session is not None and _NUMBER.fullmatch(number) else None
            if plane is None:
                raise OptionError("Measure the flatness of a place first: deviations are those from its plane.")
        key = (by, None if plane is None else (*plane.normal, *plane.centre_m))
        async with self._colouring:
            if key not in self._colours:
                found = [await asyncio.to_thread(cloud.coloured, by, plane=plane) for cloud in self.clouds]
                scale = next((scale for _, scale in found if scale is not None), None)
                self._colours[key] = ([colours for colours, _ in found], scale)
                while len(self._colours) > _KEPT:
                    self._colours.popitem(last=False)
            return self._colours[key]

    def _asked(self, request: web.Request) -> tuple[ShownCloud, Any]:
        number, index = int(request.match_info["part"]), int(request.match_info["chunk"])
        if number >= len(self.clouds) or index >= len(self.clouds[number].levels.chunks):
            raise OptionError("there are no such points.")
        return self.clouds[number], self.clouds[number].levels.chunks[index]

    async def socket(self, request: web.Request) -> web.WebSocketResponse:
        """Carry out the orders of a page until it goes."""
        socket = web.WebSocketResponse(heartbeat=_HEARTBEAT_S, max_msg_size=MOST_BYTES, compress=False)
        await socket.prepare(request)
        session = self._session(request.query.get("page", "")[:64])
        with suppress(ConnectionResetError):
            await _tell(socket, {"scene": self._id, **session.state()})
            await _talk(socket, session, len(self.clouds), self._slots)
        return socket

    def _session(self, page: str) -> Session:
        if page not in self._sessions:
            self._sessions[page] = Session(self.clouds, self._scanner)
            while len(self._sessions) > _MOST_SESSIONS:
                self._sessions.popitem(last=False)
        self._sessions.move_to_end(page)
        return self._sessions[page]


_BINARY = "application/octet-stream"


def _answer(
    find: Callable[[web.Request], Awaitable[View]],
    answer: Callable[[View, web.Request], Awaitable[web.StreamResponse]],
) -> Handler:
    """An answer of the view that a request names, or a line that says why there is none."""

    async def found(request: web.Request) -> web.StreamResponse:
        try:
            return await answer(await find(request), request)
        except JaxscanError as problem:
            return web.Response(status=404, text=" ".join(str(problem).split()) + "\n")

    return found


def _json(value: Any) -> web.Response:
    return web.Response(text=json.dumps(value, allow_nan=False), content_type="application/json")


async def _talk(socket: web.WebSocketResponse, session: Session, clouds: int, slots: asyncio.Semaphore) -> None:
    """Carry out the orders of a page until it goes; its measurements are dropped then."""
    measuring: set[asyncio.Task[None]] = set()
    # A page may go while something is measured.
    with suppress(ConnectionResetError):
        async for message in socket:
            if message.type is not WSMsgType.TEXT:
                break
            try:
                # Orders are begun one after the other: two clicks in a row are the two ends of a distance.
                answer = await asyncio.to_thread(session.begin, parse_order(message.data, clouds))
            except JaxscanError as problem:
                answer = {"message": " ".join(str(problem).split())}
            if isinstance(answer, Work):
                task = asyncio.create_task(_finish(socket, session, answer, slots))
                measuring.add(task)
                task.add_done_callback(measuring.discard)
            else:
                await _tell(socket, answer)
    await asyncio.to_thread(session.begin, Order("cancel"))
    await asyncio.gather(*measuring)


async def _tell(socket: web.WebSocketResponse, answer: dict[str, Any]) -> None:
    """Send what a page is to show."""
    await socket.send_str(json.dumps(answer, allow_nan=False))


async def _finish(socket: web.WebSocketResponse, session: Session, work: Work, slots: asyncio.Semaphore) -> None:
    try:
        async with slots:
            answer = await asyncio.to_thread(session.finish, work)
    except BaseException:
        # The page gets an answer in any case, so that it does not wait for an answer that never comes.
        await socket.close()
        raise
    if answer is not None:
        with suppress(ConnectionResetError):
            await _tell(socket, answer)
