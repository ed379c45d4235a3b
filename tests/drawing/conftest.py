"""A furnished room of the shape of an L, and what drawings are made of."""

import pytest

import jaxscan

from ..measurement.rooms import CUPBOARD, DOOR, WINDOW, seen_room


@pytest.fixture(scope="session")
def furnished_cloud():
    return seen_room(niches=(DOOR, WINDOW), boxes=(CUPBOARD,))


@pytest.fixture(scope="session")
def survey(furnished_cloud):
    return jaxscan.survey_room(furnished_cloud)
