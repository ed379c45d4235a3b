"""A viewer that serves the cloud of the tiny room."""

import numpy as np
import pytest

import jaxscan
from jaxscan.viewer import Named, serve_clouds
from jaxscan.web import open_address

from ..browser.driver import browser as browser


@pytest.fixture(scope="session")
def room(tiny):
    """The cloud."""
    return Named(str(tiny.cloud), jaxscan.load_cloud(tiny.cloud))


@pytest.fixture(scope="module")
def url(room):
    """Its address while it is served; twice, the second time without colours."""
    grey = room._replace(name="<b>grey", cloud=jaxscan.load_cloud(room.name))
    address = open_address("127.0.0.1", 0, option="--web-port")
    with serve_clouds(address, [room, grey]):
        yield address.url(with_token=True)


@pytest.fixture(scope="session")
def places(room):
    """Where the points are [n, 3], m."""
    return np.asarray(room.cloud.xyz)[np.asarray(room.cloud.valid)]
