"""Ends the HTTP server of a scheduler or a worker. Dask loads it in each of their processes that we start.

Beside its own protocol Dask serves pages that ask for no password. Without its dashboard too they tell names of
captures, paths and machines to everybody who can connect.
"""

from typing import Any


def dask_setup(node: Any) -> None:
    """Called by Dask before the first task."""
    node.http_server.stop()
