"""A finished cloud of the console in the viewer."""

import json
import shutil
import urllib.error
import urllib.request

import pytest

from jaxscan.cli.console.captures import Captures
from jaxscan.cli.console.pages import Looks
from jaxscan.viewer import view_routes
from jaxscan.web import Gate, Server, open_address

from ..browser.driver import Looks as Person
from ..browser.driver import browser as browser


@pytest.fixture(scope="module")
def served(tiny, tmp_path_factory):
    """The address of a folder with boards, their calibration, a room and its cloud."""
    folder = tmp_path_factory.mktemp("captures")
    shutil.copytree(tiny.boards, folder / "boards")
    shutil.copy(tiny.calibration, folder / "boards.json")
    shutil.copy(tiny.calibration.with_suffix(".npz"), folder / "boards.npz")
    shutil.copytree(tiny.sweep, folder / "room")
    shutil.copy(tiny.cloud, folder / "room.ply")
    shutil.copytree(tiny.sweep, folder / "later")
    address = open_address("127.0.0.1", 0, option="--web-port")
    application = Gate(address).application()
    application.add_routes(view_routes("/look/{name}", Looks(Captures(folder)).view))
    with Server(application, address):
        yield address.url(with_token=True)


@pytest.fixture
def ask(served):
    """Opens a path as a guest."""
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with pytest.raises(urllib.error.HTTPError):
        # There is no first page here, to which the token leads.
        opener.open(served)
    return lambda path: opener.open(served.partition("?")[0] + path)


def test_its_calibration_is_found_by_the_digest(ask):
    with ask("look/room/scene") as answer:
        scene = json.load(answer)
    assert scene["systematic"] is True and scene["clouds"][0]["points"] > 1000


@pytest.mark.parametrize(
    "name, says", [("later", "later: has no cloud yet; reconstruct it first."), ("..%2froom", "expected letters")]
)
def test_what_is_not_there_is_said(ask, name, says):
    with pytest.raises(urllib.error.HTTPError) as refused:
        ask(f"look/{name}/scene")
    assert refused.value.code == 404 and says in refused.value.read().decode()


def test_in_a_browser(served, browser):
    person = Person(browser)
    person.open(served)
    served = served.partition("?")[0]
    person.open(f"{served}look/room/")
    person.until(lambda: person.colours("cloud") > 20)
    assert person.complaints() == []
    person.open(f"{served}look/later/")
    person.until(lambda: person.text("loading") == "later: has no cloud yet; reconstruct it first.")
