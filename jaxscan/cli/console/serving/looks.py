"""The clouds of captures in the viewer."""

import asyncio
import os

from aiohttp import web

from jaxscan import api
from jaxscan.cli.console.captures import Captures
from jaxscan.errors import CloudError
from jaxscan.viewer import Named, View


class Looks:
    """The cloud that somebody looks at; one is held at a time."""

    def __init__(self, captures: Captures) -> None:
        """No cloud is read yet."""
        self._captures = captures
        self._held: tuple[str, int] | None = None
        self._view: View | None = None
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
            if self._view is None or state != self._held:
                self._view = None
                self._view = await asyncio.to_thread(self._read, name)
                self._held = state
            return self._view

    def _read(self, name: str) -> View:
        path = self._captures.cloud(name)
        stored = api.read_cloud(path)
        if not stored.cloud.valid.any():
            raise CloudError(f"{path}: has no points; nothing can be shown.")
        file = self._captures.calibration_of(stored.about.calibration)
        return View([Named(str(path), stored.cloud)], None if file is None else api.load_scanner(file))
