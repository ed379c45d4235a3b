"""Orders of a page, which come from outside."""

import json

import pytest

from jaxscan.errors import OptionError
from jaxscan.viewer.orders import parse_order


GOOD = {
    "do": "pick",
    "origin": [0, 0, 1.5],
    "direction": [1, 0, 0],
    "cone_rad": 0.01,
    "clouds": [{"number": 1, "shift": [0, 0, 0]}],
    "section": [[-1, -1, -1], [1, 1, 1]],
}


def test_a_good_one():
    order = parse_order(json.dumps(GOOD), 2)
    assert order.do == "pick" and order.ray.origin.tolist() == [0, 0, 1.5] and order.ray.cone_rad == 0.01
    assert order.shifts[0][0] == 1 and order.section.shape == (2, 3)
    assert parse_order(json.dumps({"do": "room", "clouds": []}), 1).shifts == ()
    assert parse_order('{"do": "save", "what": "csv"}', 1).what == "csv"
    assert parse_order('{"do": "remove", "id": 7}', 1).id == 7
    assert parse_order('{"do": "close"}', 1).do == "close" and not order.surface
    assert parse_order(json.dumps(GOOD | {"do": "cut", "surface": True}), 2).surface
    assert order.turn_rad == 0 and parse_order(json.dumps(GOOD | {"turn_rad": 0.5}), 2).turn_rad == 0.5


@pytest.mark.parametrize(
    "change",
    [
        {"do": "delete"},
        {"do": "save", "what": "../x"},
        {"do": "choose", "what": "all"},
        {"do": ["pick"]},
        {"origin": [0, 0]},
        {"origin": [0, 0, "1"]},
        {"origin": [0, 0, 1e300]},
        {"origin": [0, 0, 10**400]},
        {"origin": [0, 0, True]},
        {"origin": None},
        {"direction": [0, 0, 0]},
        {"cone_rad": 3.0},
        {"cone_rad": None},
        {"clouds": None},
        {"clouds": 7},
        {"clouds": [{"number": 2, "shift": [0, 0, 0]}]},
        {"clouds": [{"number": -1, "shift": [0, 0, 0]}]},
        {"clouds": [{"number": 1.5, "shift": [0, 0, 0]}]},
        {"clouds": [{"number": 0}]},
        {"clouds": 3 * [{"number": 0, "shift": [0, 0, 0]}]},
        {"section": [[0, 0, 0]]},
        {"do": "box", "section": None},
        {"do": "cut", "section": None},
        {"section": "all"},
        {"turn_rad": "much"},
        {"turn_rad": None},
        {"do": "remove"},
        {"do": "remove", "id": [1]},
    ],
)
def test_bad_ones(change):
    with pytest.raises(OptionError):
        parse_order(json.dumps(GOOD | change), 2)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"do": "pick", "origin": [NaN, 0, 0]}', "[" * 5000])
def test_no_json_or_no_order(text):
    with pytest.raises(OptionError):
        parse_order(text, 1)
