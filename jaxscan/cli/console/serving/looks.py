"""The clouds of captures in the viewer."""

import asyncio
import os
from collections import OrderedDict

from aiohttp import web

from jaxscan import api
from jaxscan.cli.console.captures import Captures
from jaxscan.errors import CloudError
from jaxscan.viewer import Named, View


MOST = 3
"""Clouds that are held."""


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
                # A cloud that was made again is another one.
                state = name, os.stat(path).st_mtime_ns
            except OSError as problem:
                raise CloudError(f"{name}: has no cloud yet; reconstruct it first.") from problem
            if state not in self._views:
                while len(self._views) >= MOST:
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
