"""Clouds behind the gate: the drawing server on the loopback, and the pages that lead to it."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import PointCloud
from jaxscan.viewer.door import PASS_HEADER, Door
from jaxscan.viewer.panel import Panel
from jaxscan.viewer.scene import Scene
from jaxscan.viewer.shown import ShownCloud
from jaxscan.web import Address, Gate, Server, proxy_routes


class Named(NamedTuple):
    """A cloud to show."""

    name: str
    cloud: PointCloud
    """In metres, z up, with one valid point at least."""
    turned: bool = False
    """Whether its axes are not those of its file."""


@contextmanager
def serve_clouds(address: Address, clouds: Sequence[Named], scanner: Scanner | None = None) -> Iterator[Scene]:
    """Show clouds at an address, within `with`.

    Args:
        address: Where to listen.
        clouds: One or more.
        scanner: With which they were made; sigma then includes the calibration's part.
    """
    first = np.asarray(clouds[0].cloud.xyz)[np.asarray(clouds[0].cloud.valid)]
    # A place on a map has more digits than a browser's numbers.
    origin = np.round(np.median(first[:: max(1, len(first) // 10_000)].astype(np.float64), 0))
    with ExitStack() as stack:
        door = Door()
        server = stack.enter_context(door)
        shown = [ShownCloud(one.name, one.cloud, origin, turned=one.turned) for one in clouds]
        scene = Scene(server, shown, scanner)
        Panel(server, scene, systematic=scanner is not None)
        application = Gate(address).application()
        application.add_routes(proxy_routes("", door.port, {PASS_HEADER: door.key}))
        stack.enter_context(Server(application, address))
        yield scene
