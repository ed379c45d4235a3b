"""One rendered corner of a room for all tests of this folder."""

import pytest

from tests.photographs.rendered import make_world


@pytest.fixture(scope="session")
def world():
    return make_world()
