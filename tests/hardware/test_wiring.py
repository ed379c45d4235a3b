"""The wiring drawing has the firmware's pins, by the firmware's names, and is drawn from its list."""

import importlib.util
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[2]
HARDWARE = ROOT / "hardware"
PINS = tomllib.loads((HARDWARE / "wiring" / "wiring.toml").read_text())["pin"]
UNO = {f"PD{bit}": f"D{bit}" for bit in range(8)} | {f"PB{bit}": f"D{8 + bit}" for bit in range(6)} | {"PC0": "A0"}
"""Where an Uno has the chip's pins: the order of its headers."""


@pytest.fixture(scope="module")
def draw():
    spec = importlib.util.spec_from_file_location("wiring_draw", HARDWARE / "wiring" / "draw.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def defined():
    """Names and places of all pins in the firmware."""
    text = (HARDWARE / "firmware" / "pins.h").read_text()
    return dict(re.findall(r"^#define (\w+) _BV\((P[BCD]\d)\)", text, re.MULTILINE))


def test_every_pin_of_the_firmware_is_wired_where_it_is():
    assert len(defined()) == 11
    assert {pin["name"]: pin["chip"] for pin in PINS} == defined()
    assert all(pin["uno"] == UNO[pin["chip"]] for pin in PINS)


def test_directions_are_those_of_the_firmware():
    text = (HARDWARE / "firmware" / "pins.h").read_text()
    inputs = set(re.findall(r"^#define (\w+) _BV", text[text.index("/* inputs */") :], re.MULTILINE))
    assert {pin["name"] for pin in PINS if pin["way"] == "in"} == inputs == {"HOME_N", "ESTOP", "RDY"}
    assert {pin["way"] for pin in PINS} == {"in", "out"}


def test_pins_are_those_of_the_firmwares_page_and_of_the_protocol():
    page = (HARDWARE / "firmware" / "README.md").read_text()
    rows = dict(re.findall(r"^\| (P[BCD]\d) \| (\w+) \|", page, re.MULTILINE))
    assert {pin["chip"]: pin["uno"] for pin in PINS} == rows
    for ohms in {part for pin in PINS for part in re.findall(r"\d+ k?Ω|\d+ nF", pin.get("through", ""))}:
        assert ohms in page, ohms
    (estop,) = (pin for pin in PINS if pin["name"] == "ESTOP")
    assert f"**E-stop input**, {estop['chip']} with pull-up" in (HARDWARE / "PROTOCOL.md").read_text()


def test_the_drawing_is_of_this_list(draw):
    stored = (ROOT / "docs" / "hardware" / "wiring.svg").read_text(encoding="utf-8")
    assert draw.drawing() == stored, "make wiring"
    words = {element.text for element in ElementTree.fromstring(stored).iter("{http://www.w3.org/2000/svg}text")}
    assert words >= {pin["name"] for pin in PINS} | {f"{pin['uno']} · {pin['chip']}" for pin in PINS}


def test_what_a_list_says_cannot_be_markup(draw, tmp_path):
    source = (HARDWARE / "wiring" / "wiring.toml").read_text().replace('terminal = "STEP"', 'terminal = "<a&b>"')
    (tmp_path / "wiring.toml").write_text(source)
    words = [element.text for element in ElementTree.fromstring(draw.drawing(tmp_path / "wiring.toml")).iter()]
    assert "<a&b>" in words
