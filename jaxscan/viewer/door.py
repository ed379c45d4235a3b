"""The drawing server, on the loopback: it has no lock of its own, so only who knows a pass comes through."""

import contextlib
import hmac
import io
import secrets
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server as websockets
from websockets.http11 import Request, Response


PASS_HEADER = "X-Jaxscan-Pass"


class Door:
    """A drawing server within `with`."""

    def __init__(self) -> None:
        """Begin to listen at a free port of the loopback."""
        self.key = secrets.token_urlsafe()
        """What a request must bring in `PASS_HEADER`."""
        # It prints its address, at which nobody but the gate comes in.
        with contextlib.redirect_stdout(io.StringIO()), _guarded(self.key):
            self.server = viser.ViserServer("127.0.0.1", 0, verbose=False)
        # Any page may ask for a tunnel through a server elsewhere.
        self.server.request_share_url = _no_tunnel  # type: ignore[method-assign]
        self.port = self.server.get_port()

    def __enter__(self) -> viser.ViserServer:
        return self.server

    def __exit__(self, *_: object) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


@contextlib.contextmanager
def _guarded(key: str) -> Iterator[None]:
    """Lets servers that begin to listen meanwhile refuse who does not know the key, WebSockets too.

    A WebSocket to the loopback may be opened by any page of any site, and viser asks nobody where he comes from; it
    has no option for that.
    """
    serve = websockets.serve

    def guarded(*arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def check(connection: websockets.ServerConnection, request: Request) -> Response | None:
            if not hmac.compare_digest(request.headers.get(PASS_HEADER, "").encode(), key.encode()):
                return connection.respond(HTTPStatus.FORBIDDEN, "Open the address that the terminal shows.\n")
            answer: Response | None = process_request(connection, request)
            return answer

        return serve(*arguments, process_request=check, **options)

    websockets.serve = guarded  # type: ignore[assignment]
    try:
        yield
    finally:
        websockets.serve = serve  # type: ignore[misc]


def _no_tunnel(verbose: bool = True) -> None:
    return None
