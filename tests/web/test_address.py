"""What is printed of an address: the name, and this machine's own number."""

import socket

import pytest

from jaxscan.web import address, open_address


def opened(host):
    """An address; its socket is not listened to any more."""
    found = open_address(host, 0, option="--web-port")
    found.socket.close()
    return found


class Asking:
    """A socket that finds its way by an interface with this number, or none."""

    def __init__(self, own):
        self.own = own

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        pass

    def connect(self, place):
        if self.own is None:
            raise OSError("Network is unreachable")

    def getsockname(self):
        return self.own, 40000


@pytest.mark.parametrize("number", ["192.168.1.5", None])
def test_all_interfaces_are_shown_by_number_too(monkeypatch, number):
    monkeypatch.setattr(address, "own_number", lambda: number)
    wide = opened("0.0.0.0")
    said = [f"Open this address in a browser: http://{socket.gethostname()}:{wide.port}/?token={wide.token}"]
    if number:
        said += [f"On a machine that does not find that name: http://192.168.1.5:{wide.port}/?token={wide.token}"]
    assert wide.invitation() == tuple(said)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_single_interface_is_shown_once(host):
    one = opened(host)
    assert one.invitation() == (f"Open this address in a browser: http://{host}:{one.port}/?token={one.token}",)


def test_the_own_number_is_one_of_this_machine():
    number = address.own_number()
    if number is None:
        pytest.skip("this machine has no network")
    # Only a number of this machine can be bound.
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listening:
        listening.bind((number, 0))


def test_without_a_network_there_is_no_number(monkeypatch):
    for own in ("127.0.0.1", "0.0.0.0", "169.254.1.1"):
        monkeypatch.setattr(address.socket, "socket", lambda *kind, own=own: Asking(own))
        assert address.own_number() is None
    monkeypatch.setattr(address.socket, "socket", lambda *kind: Asking(None))
    assert address.own_number() is None
