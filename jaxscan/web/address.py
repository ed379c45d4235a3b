"""Where pages are served: a socket that listens, the names under which a browser may ask for it, and the token."""

import ipaddress
import secrets
import socket
from dataclasses import dataclass, replace

from jaxscan.errors import OptionError


_LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
_ANYWHERE = {"0.0.0.0", "::"}
_AFAR = ("192.0.2.1", "10.0.0.1", "192.168.0.1", "172.16.0.1")
"""Addresses outside, to find the interface of the default route; and private ones, for networks without such a
route."""
_WAITING = 512


@dataclass(frozen=True)
class Address:
    """A listening socket, and who may come to it."""

    socket: socket.socket
    host: str
    port: int
    names: frozenset[str]
    """Names of this machine in the header Host; further ones are refused."""
    token: str
    """The word that opens it, on the loopback too: others may have an account on this machine."""
    wide: bool
    """Whether other machines can reach it."""

    def url(self, *, with_token: bool = False) -> str:
        """The address for a browser on this machine, or on another one where it is wide."""
        host = socket.gethostname() if self.host in _ANYWHERE else self.host
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/" + (f"?token={self.token}" if with_token else "")

    def invitation(self) -> tuple[str, ...]:
        """What to print: the address with its token, and where it names all interfaces the same by number.

        Few telephones know the name of a machine; all know its number.
        """
        lines = [f"Open this address in a browser: {self.url(with_token=True)}"]
        number = own_number() if self.host == "0.0.0.0" else None
        if number is not None:
            numbered = replace(self, host=number).url(with_token=True)
            lines.append(f"On a machine that does not find that name: {numbered}")
        return tuple(lines)

    def knows(self, name: str) -> bool:
        """Whether a name in the header Host is one of this machine.

        A page of a stranger can give this machine a name of its own, but no bare number: a browser that asks for a
        number was sent to that number.
        """
        return name.lower().rstrip(".") in self.names or (self.wide and _is_number(name))


def open_address(host: str, port: int, *, option: str) -> Address:
    """Listen at an address, which gets a token.

    Args:
        host: Name or number of the network interface.
        port: TCP port; 0 for any that is free.
        option: Name of the option that chose the port, for messages.

    Raises:
        OptionError: If it is taken, not allowed or not of this machine.
    """
    if not 0 <= port <= 65535:
        raise OptionError(f"{option}: found {port}, expected 0 ... 65535.")
    try:
        family, _, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as problem:
        raise OptionError(f"--host: found {host!r}, expected a name or number of this machine: {problem}.") from problem
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        # Usual for servers: a port is free again as soon as its server has ended.
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(where)
        listening.listen(_WAITING)
    except OSError as problem:
        listening.close()
        raise OptionError(_why_not(host, port, option, problem)) from problem
    bound = listening.getsockname()
    narrow = ipaddress.ip_address(bound[0]).is_loopback
    names = _LOOPBACK_NAMES | {host.lower(), bound[0]}
    if not narrow:
        own = socket.gethostname().lower()
        names |= {own, f"{own}.local"}
    return Address(listening, host, bound[1], frozenset(names - _ANYWHERE), secrets.token_urlsafe(), wide=not narrow)


def own_number() -> str | None:
    """This machine's number in its network, as other machines there know it; None without a network."""
    for place in _AFAR:
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
                # It chooses the interface; nothing is sent.
                asking.connect((place, 9))
                number = ipaddress.ip_address(asking.getsockname()[0])
        except OSError:
            continue
        if not (number.is_loopback or number.is_unspecified or number.is_link_local):
            return str(number)
    return None


def _why_not(host: str, port: int, option: str, problem: OSError) -> str:
    says = (problem.strerror or str(problem)).lower()
    if "in use" in says:
        return f"{option}: the port {port} is taken by another program; choose another, or 0 for any that is free."
    if isinstance(problem, PermissionError):
        return f"{option}: the port {port} is kept for the system; choose one above 1023."
    return f"--host: found {host!r}, expected a name or number of this machine: {says}."


def _is_number(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
