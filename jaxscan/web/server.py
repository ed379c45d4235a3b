"""A server in a thread of its own: the main thread answers signals, and may drive a rig meanwhile."""

import asyncio
import threading
from collections.abc import Callable
from types import TracebackType

from aiohttp import web

from jaxscan.web.address import Address


_END_S = 1.0
"""So long connections may take to end."""
_TURNS = 10
"""Of the loop, until the runner knows a connection that was accepted; three would do."""


class Server:
    """Serves an application within `with`."""

    def __init__(self, application: web.Application, address: Address) -> None:
        self._application, self._address = application, address
        self._begun = threading.Event()
        self._thread = threading.Thread(target=self._run, name="jaxscan-web", daemon=True)
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._problem: BaseException | None = None

    def __enter__(self) -> "Server":
        self._thread.start()
        self._begun.wait()
        if self._problem is not None:
            raise self._problem
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.call(self._end.set)
        self._thread.join()
        self._address.socket.close()

    def call(self, work: Callable[[], object]) -> None:
        """Do something in the server's thread, soon."""
        self._loop.call_soon_threadsafe(work)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        except BaseException as problem:
            self._problem = problem
            raise
        finally:
            self._begun.set()
            self._loop.close()

    async def _serve(self) -> None:
        runner = web.AppRunner(self._application, access_log=None, shutdown_timeout=_END_S)
        await runner.setup()
        try:
            await web.SockSite(runner, self._address.socket).start()
            self._begun.set()
            await self._end.wait()
        finally:
            # A connection that is accepted in the turn of the loop in which asyncio's server closes is never closed
            # (CPython 3.11). So none is accepted any more, and the runner hears of the last ones, some turns later.
            self._loop.remove_reader(self._address.socket)
            for _ in range(_TURNS):
                await asyncio.sleep(0)
            transports = [connection.transport for connection in runner.server.connections] if runner.server else []
            await runner.cleanup()
            # Where the other end reads nothing, a transport waits for what is still to be sent.
            for transport in transports:
                if transport is not None:
                    transport.abort()
            await asyncio.sleep(0)
