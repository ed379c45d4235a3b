"""Files of the package that a browser may read: those that are named, and no others."""

from collections.abc import Iterable, Mapping
from importlib import resources
from typing import NamedTuple

from aiohttp import web
from aiohttp.typedefs import Handler


PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)
"""Content-Security-Policy of our own pages: nothing from elsewhere, and no script within the page."""


class Resource(NamedTuple):
    """A file of a package."""

    package: str
    name: str
    content_type: str
    """With its character set."""


def resource_routes(listed: Mapping[str, Resource]) -> Iterable[web.RouteDef]:
    """A route for each file, by its path in the address; files are read now, so that no request opens one."""
    for path, resource in listed.items():
        # The package's own files: no door for those of strangers.
        body = resources.files(resource.package).joinpath(resource.name).read_bytes()
        yield web.get(path, _answer(body, resource.content_type))


def _answer(body: bytes, content_type: str) -> Handler:
    headers = {"Content-Type": content_type, "Content-Security-Policy": PAGE_POLICY}

    async def answer(request: web.Request) -> web.StreamResponse:
        return web.Response(body=body, headers=headers)

    return answer
