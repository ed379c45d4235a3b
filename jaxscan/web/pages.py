"""Pages of a package, which a browser may read: the files of its folder `page` and of ours, and no others."""

from collections.abc import Iterable
from importlib import resources

from aiohttp import web
from aiohttp.typedefs import Handler


PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)
"""Content-Security-Policy of our own pages: nothing from elsewhere, and no script within the page."""
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


def page_routes(package: str, prefix: str = "") -> Iterable[web.RouteDef]:
    """A route for each file of a page, `index.html` as the folder itself, and for those that all pages share.

    Files are read now, so that no request opens one.

    Args:
        package: With a folder `page`.
        prefix: Before each path.
    """
    # The package's own files: no door for those of strangers.
    for file in (
        one for owner in ("jaxscan.web", package) for one in resources.files(owner).joinpath("page").iterdir()
    ):
        kind = _TYPES.get(file.name.rpartition(".")[2])
        if kind is not None:
            path = "" if file.name == "index.html" else file.name
            yield web.get(f"{prefix}/{path}", _answer(file.read_bytes(), f"{kind}; charset=utf-8"))


def _answer(body: bytes, content_type: str) -> Handler:
    headers = {"Content-Type": content_type, "Content-Security-Policy": PAGE_POLICY}

    async def answer(request: web.Request) -> web.StreamResponse:
        return web.Response(body=body, headers=headers)

    return answer
