"""`jaxscan design` on the command line."""

import json

import pytest

import jaxscan
from jaxscan.cli.design import DEGREES, METRES, MICROMETRES, quantity
from jaxscan.errors import OptionError

from ..cli.conftest import refused, run  # noqa: F401


WISH = ("design", "--range", "3", "--sigma", "1.5mm")


def test_design(run, tmp_path):  # noqa: F811
    picture, rig, result = tmp_path / "design.png", tmp_path / "rig.toml", tmp_path / "design.json"
    ran = run(*WISH, "-o", picture, "--save-rig", rig, "--json", result)
    assert ran.code == 0, ran
    found = json.loads(result.read_text())
    assert found["format"] == "jaxscan-design/1"
    chosen, rows = found["chosen"], found["sigma"]
    assert chosen["reaches"] and chosen["sigma_mm"] <= 1.5
    at_range = next(row for row in rows if row["depth_m"] == 3.0)
    assert at_range["depth_mm"] == pytest.approx(chosen["sigma_mm"]) and at_range["stripe_mm"] < at_range["depth_mm"]
    assert {one["reaches"] for one in found["alternatives"]} == {True, False}
    assert f"lens {chosen['lens_mm']:g} mm" in ran.out and "does not" in ran.out
    assert found["scan"]["steps"] == 1800 and 300 < found["scan"]["seconds_s"] < 400
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    simulated = jaxscan.load_simulation(rig)
    assert simulated.camera.fx == pytest.approx(chosen["focal_px"], abs=0.01)
    (laser,) = simulated.laser
    assert (laser.baseline_m, laser.crossing_m, laser.fan_deg) == (chosen["baseline_m"], 3.0, chosen["fan_deg"])


def test_the_time_of_a_scan_is_that_of_the_firmware():
    """1800 steps of 16 microsteps at 400 to 4000 a second, 120 ms of a shot (PROTOCOL.md, section 4), 30 ms beside."""
    from jaxscan.cli.design import _scan_seconds

    seconds = _scan_seconds(0.2)
    move = 2 * ((400**2 + 8000 * 16) ** 0.5 - 400) / 8000
    assert seconds == pytest.approx(1800 * (0.120 + 0.030 + move), rel=0.01)


@pytest.mark.parametrize(
    "words, told",
    [
        (("--range", "-4"), "--range"),
        (("--range", "0"), "0.05 m to 100 m"),
        (("--range", "4 apples"), "4 apples"),
        (("--range", "4e3"), "--range"),
        (("--range", "nan"), "--range"),
        (("--sigma", "0mm"), "--sigma"),
        (("--sigma", "1px"), "units m, cm, mm, um"),
        (("--sigma", "0.001mm"), "possible are"),
        (("--camera", "1440"), "WIDTHxHEIGHT"),
        (("--camera", "65535x65535"), "at most 100 megapixels"),
        (("--pixel", "3.45"), "units um"),
        (("--baseline", "2m"), "--longest-baseline"),
        (("--field", "120"), "--field"),
        (("--field", "100deg", "--lens", "50mm"), "at most 11°"),
        (("--range", "0.2", "--baseline", "0.3m"), "no baseline is short enough"),
        (("--stripe-noise", "0"), "--stripe-noise"),
        (("--step", "0"), "--step"),
        (("-o", "design.jpg"), ".png"),
        (("--save-rig", "rig.json"), ".toml"),
    ],
)
def test_bad_input_is_one_line(refused, words, told):  # noqa: F811
    assert told in refused(*WISH, *words)


def test_quantities():
    assert quantity("--x", "25 cm", METRES, (0.0, 1.0)) == pytest.approx(0.25)
    assert quantity("--x", ".5", METRES, (0.0, 1.0)) == 0.5
    assert quantity("--x", "3.45µm", MICROMETRES, (0.0, 9.0)) == 3.45
    assert quantity("--x", "0.2°", DEGREES, (0.0, 9.0)) == 0.2
    for text in ("", "m", "1,5m", "1m2", "٣m", "1 m m", "--1", "inf", "1e3", "0x10", "9" * 400):
        with pytest.raises(OptionError, match="--x"):
            quantity("--x", text, METRES, (0.0, 1.0))
