"""Carries out the orders of one page: a measurement does not hold up the orders after it."""

import asyncio
import json
from contextlib import suppress
from typing import Any

from aiohttp import WSMsgType, web

from jaxscan.errors import JaxscanError
from jaxscan.viewer.orders import Order, parse_order
from jaxscan.viewer.session import Session, Work


AT_ONCE = 2
"""Measurements of all pages together that go on at a time, those whose answers nobody wants any more among them."""


async def talk(socket: web.WebSocketResponse, session: Session, clouds: int, slots: asyncio.Semaphore) -> None:
    """Carry out the orders of a page until it goes; its measurements are dropped then.

    Args:
        socket: Of the page.
        session: What the page measured so far.
        clouds: How many there are.
        slots: For `AT_ONCE` measurements.
    """
    measuring: set[asyncio.Task[None]] = set()
    # A page may go while something is measured.
    with suppress(ConnectionResetError):
        async for message in socket:
            if message.type is not WSMsgType.TEXT:
                break
            try:
                # In their order: two clicks in a row are the two ends of a distance.
                answer = await asyncio.to_thread(session.begin, parse_order(message.data, clouds))
            except JaxscanError as problem:
                answer = {"message": " ".join(str(problem).split())}
            if isinstance(answer, Work):
                task = asyncio.create_task(_finish(socket, session, answer, slots))
                measuring.add(task)
                task.add_done_callback(measuring.discard)
            else:
                await tell(socket, answer)
    await asyncio.to_thread(session.begin, Order("cancel"))
    await asyncio.gather(*measuring)


async def tell(socket: web.WebSocketResponse, answer: dict[str, Any]) -> None:
    """Send what a page is to show."""
    await socket.send_str(json.dumps(answer, allow_nan=False))


async def _finish(socket: web.WebSocketResponse, session: Session, work: Work, slots: asyncio.Semaphore) -> None:
    try:
        async with slots:
            answer = await asyncio.to_thread(session.finish, work)
    except BaseException:
        # A page does not wait for what never comes.
        await socket.close()
        raise
    if answer is not None:
        with suppress(ConnectionResetError):
            await tell(socket, answer)
