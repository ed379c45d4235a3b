"""Clouds of other programs in a real browser: places without colours or normals."""

import numpy as np
import pytest

import jaxscan
from jaxscan.viewer import Named, serve_clouds
from jaxscan.web import open_address

from ..browser.driver import Looks


@pytest.fixture(scope="module")
def bare(room, places, tmp_path_factory):
    """The points of the room as text: x y z and nothing else."""
    path = tmp_path_factory.mktemp("foreign") / "bare.xyz"
    np.savetxt(path, places, fmt="%.4f")
    return Named(str(path), jaxscan.load_cloud(path))


@pytest.fixture
def looks(browser):
    yield Looks(browser)
    browser.execute_script("if (location.origin !== 'null') sessionStorage.clear()")
    browser.get("about:blank")


def test_places_alone_are_coloured_by_their_height(looks, bare):
    address = open_address("127.0.0.1", 0, option="--web-port")
    with serve_clouds(address, [bare]):
        looks.open(address.url(with_token=True))
        looks.until(lambda: looks.colours("cloud") > 20 and looks.text("scale-words").endswith(" m"))
        offered = "return Array.from(document.querySelectorAll('#by option'), (one) => one.value)"
        assert looks.driver.execute_script(offered) == ["height", "deviation"]
        assert not looks.at("backs-part").is_displayed() and looks.complaints() == []


def test_the_box_on_backs_says_of_which_clouds(looks, room, bare):
    address = open_address("127.0.0.1", 0, option="--web-port")
    with serve_clouds(address, [room, bare]):
        looks.open(address.url(with_token=True))
        name = room.name.rpartition("/")[2]
        looks.until(lambda: looks.text("backs-part") == f"hide what is seen from behind, of {name}")
        # Beside one with colours it is grey, not as dark as the ground.
        looks.until(lambda: looks.colours("cloud") > 20)
        assert looks.complaints() == []
