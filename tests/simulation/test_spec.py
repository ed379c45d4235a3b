"""The configuration of a simulated rig: every number has a range, and what cannot be rendered is refused by its key."""

import typing

import pydantic
import pytest

from jaxscan.errors import ConfigError
from jaxscan.files import load_toml
from jaxscan.simulation import SimulationConfig
from jaxscan.simulation.settings import LaserSpec


SMALL = """
[camera]
width = 96
height = 80
[laser]
baseline_m = 0.4
crossing_m = 3.0
[room]
[boards]
type = "charuco"
"""


def load(tmp_path, text):
    (tmp_path / "rig.toml").write_text(text)
    return load_toml(tmp_path / "rig.toml", SimulationConfig)


def test_the_small_one_is_read(tmp_path):
    assert load(tmp_path, SMALL).camera.width == 96


@pytest.mark.parametrize(
    ("table", "line", "message"),
    [
        ("camera", "width = 70000", "camera.width: found 70000, expected less than or equal to 65535"),
        ("camera", "fx = 1e-300", "camera.fx: found 1e-300"),
        ("camera", "k1 = nan", "camera.k1: found NaN"),
        ("laser", 'name = ""', "laser.name"),
        ("laser", "waist_mm = 1e300", "laser.waist_mm: found 1e+300"),
        ("laser", "bow = [inf, 0.0]", "laser.bow"),
        ("boards", "tilt_deg = [nan, 45.0]", "boards.tilt_deg"),
        ("boards", "marker_mm = 30.0", "marker_mm = 30 must be smaller than square_mm = 30"),
        ("boards", "square_mm = 1e308", "boards.square_mm: found 1e+308"),
        ("boards", "free_views = 10000000", "boards.free_views: found 10000000"),
        ("boards", "placements = 1000", "boards.placements: found 1000"),
        ("boards", 'dictionary = "DICT_FOO"', 'boards.dictionary: found "DICT_FOO", expected a dictionary of OpenCV'),
        ("boards", "columns = 40\nrows = 40", "40 x 40 squares need 800 markers, and DICT_5X5_250 has 250"),
        ("boards", "columns = 2", "found 2 x 9, expected at least 3 each"),
        ("sensor", "psf_px = 1e6", "sensor.psf_px: found 1000000.0"),
        ("sensor", "psf_px = inf", "sensor.psf_px: found Infinity"),
        ("sensor", "psf_px = 1e-320", "sensor.psf_px"),
        ("plan", "steps = 99999999999", "plan.steps: found 99999999999"),
        ("light", "white_dn = 1e300", "light.white_dn"),
    ],
)
def test_numbers_out_of_range_are_refused_by_their_key(tmp_path, table, line, message):
    keys = [one.split(" =")[0] for one in line.splitlines()]
    lines = [one for one in SMALL.splitlines() if one.split(" =")[0] not in keys]
    text = "\n".join(lines)
    text = text.replace(f"[{table}]", f"[{table}]\n{line}") if f"[{table}]" in text else f"{text}\n[{table}]\n{line}"
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    found = str(caught.value)
    assert message in found.replace("laser[0]", "laser") and "\n" not in found


def bounded(annotation, limits):
    """Whether a number of this type lies between two limits, for all types that the annotation is made of."""
    if annotation in (float, int):
        return "lower" in limits and "upper" in limits
    inner = typing.get_args(annotation)
    if typing.get_origin(annotation) is typing.Literal:
        return True
    if typing.get_origin(annotation) is typing.Annotated:
        return bounded(inner[0], limits | ends(inner[1:]))
    return all(bounded(one, limits) for one in inner)


def ends(metadata):
    found = set()
    for one in metadata:
        for part in getattr(one, "metadata", [one]):
            found |= {"lower"} if any(hasattr(part, name) for name in ("ge", "gt")) else set()
            found |= {"upper"} if any(hasattr(part, name) for name in ("le", "lt")) else set()
    return found


def sections(model):
    yield model
    for field in model.model_fields.values():
        for one in (field.annotation, *typing.get_args(field.annotation)):
            if isinstance(one, type) and issubclass(one, pydantic.BaseModel):
                yield from sections(one)


def test_every_number_has_two_limits():
    names = 0
    for model in sections(SimulationConfig):
        for name, field in model.model_fields.items():
            names += 1
            assert bounded(field.annotation, ends(field.metadata)), f"{model.__name__}.{name}"
    assert names > 60


@pytest.mark.parametrize("baseline", [1e-300, -1e-200, 5e-324])
def test_a_baseline_of_nothing_is_refused_without_a_warning(baseline):
    """Warnings are errors here; one on the terminal would be a second line."""
    with pytest.raises(pydantic.ValidationError, match="no plane"):
        LaserSpec(name="red", baseline_m=baseline, crossing_m=1.0)
