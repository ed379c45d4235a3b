"""The native fit and choice against the reference: the same stripes within the rounding of single precision."""

import functools

import jax
import numpy as np
import pytest

from jaxscan.stripes.choosing.native import ChosenLines
from jaxscan.stripes.choosing.on_lines import choose_stripes
from jaxscan.stripes.fitting.fit_blocks import fit_candidates
from jaxscan.stripes.fitting.native import NativeFitter
from jaxscan.stripes.frames.formats import FrameFormat, LaserLine
from jaxscan.stripes.search.native import NativeLocator
from jaxscan.stripes.search.planes import Planes
from jaxscan.stripes.search.search import prepare_search, whole_lines
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes, MeasuredLines, NoiseModel, StripeSettings


FRAMES, LINES, SAMPLES = 3, 70, 203
FIT = jax.jit(fit_candidates, static_argnames="setup")
CHOOSE = jax.jit(choose_stripes, static_argnames="setup")
REAL = tuple(name for name in FrameStripes._fields if name not in ("saturated", "valid"))


def _setup(pixel_format="mono8", response="linear", all_candidates=False, **settings):
    colour = "red" if pixel_format == "mono8" else "green"
    frames, line = FrameFormat(pixel_format, response), LaserLine(colour=colour)
    width = SAMPLES if pixel_format == "mono8" else 2 * SAMPLES
    return ExtractionSetup((width, LINES), frames, line, StripeSettings(**settings), all_candidates=all_candidates)


@functools.cache
def _planes():
    """Stripes of all widths and heights, one to three on a line, clipped ones too, over printed edges."""
    rng = np.random.default_rng(3)
    x, shape = np.arange(SAMPLES)[None, None, :], (FRAMES, LINES, 1)
    room = 20.0 + 40.0 * (np.sin(x / 17.0) > 0.3) + 0.0 * rng.uniform(size=shape)
    light = np.zeros((FRAMES, LINES, SAMPLES))
    for slope in (0.4, -0.7, 0.0):
        centre = rng.uniform(20, 180) + slope * np.arange(LINES)[None, :, None] + rng.normal(0, 0.3, shape)
        height = 10 ** rng.uniform(0.6, 2.8, shape) * (rng.uniform(size=shape) < 0.8)
        light += height * np.exp(-0.5 * ((x - centre) / rng.uniform(0.5, 6.0, shape)) ** 2)
    noisy = lambda level: np.clip(np.round(level + rng.normal(0, np.sqrt(1 + level / 40), level.shape)), 0, 255)
    on, off = noisy(room * (1 + light / 60)), noisy(np.broadcast_to(room, light.shape))
    return Planes(on.astype(np.uint8), off.astype(np.uint8), np.array([1.0, 1.02, 0.97], np.float32))


def _search(setup, **known):
    search = prepare_search(setup, NoiseModel(black_dn=3.0), whole_lines(setup, near_side=-1), has_off=True)
    return search._replace(**{name: np.asarray(value, np.float32) for name, value in known.items()})


def _measured(setup, search):
    planes = _planes()
    if setup.sites.line_step == 2:
        planes = planes._replace(on=planes.on[:, ::2], off=planes.off[:, ::2])
    located = NativeLocator().locate(planes, search, pitch=setup.sites.pitch, saturation=254)
    return located, planes.lamp_ratio, NativeFitter().fit(located, planes.lamp_ratio, search, setup)


@pytest.mark.parametrize(
    "known", [{}, {"speckle": 0.2, "log_width": 0.5, "width_information": 30.0}], ids=["plain", "prior"]
)
@pytest.mark.parametrize(
    "how",
    [{}, {"response": "srgb"}, {"pixel_format": "bayer_rggb8"}, {"guard_edges": False, "choice": "brightest"}],
    ids=["linear", "srgb", "mosaic", "no guard"],
)
def test_same_fits(how, known):
    setup = _setup(**how)
    search = _search(setup, **known)
    located, ratio, found = _measured(setup, search)
    with jax.enable_x64(False):
        expected = jax.tree.map(np.asarray, FIT(located.lists, ratio, search, setup=setup))
    behind = located.lists[0].start.size
    real = np.r_[: int(located.lists[0].total), behind : behind + int(located.lists[1].total)]
    got = FrameStripes(*(field[real] for field in found.measured))
    expected = FrameStripes(*(field[real] for field in expected))
    assert 0.3 < expected.valid.mean() < 1.0 and expected.saturated.max() > 2
    # Single precision decides the few fits that lie on a limit, or on the border between one step more or less.
    same = got.valid == expected.valid
    assert same.mean() > 0.995
    both = got.valid & expected.valid
    np.testing.assert_array_equal(got.saturated[both], expected.saturated[both])
    error = np.abs(got.u - expected.u)[both] / expected.sigma[both]
    assert np.quantile(error, 0.99) < 0.005
    # Where most of a narrow stripe is clipped its samples hardly determine it.
    assert error[got.saturated[both] == 0].max() < 0.02
    for name in REAL:
        a, b = getattr(got, name)[both], getattr(expected, name)[both]
        close = np.isclose(a, b, rtol=2e-3, atol=2e-3)
        assert close.mean() > 0.99, name
    for field in got:
        assert not field[~got.valid].any()


@pytest.mark.parametrize("all_candidates", [False, True])
@pytest.mark.parametrize("choice", ["path", "brightest", "nearest", "farthest", "all"])
@pytest.mark.parametrize("pixel_format", ["mono8", "bayer_rggb8"])
def test_same_choice(choice, all_candidates, pixel_format):
    setup = _setup(pixel_format, choice=choice, all_candidates=all_candidates)
    search = _search(setup)
    located, _, found = _measured(setup, search)
    measured = MeasuredLines(FrameStripes(*(field.copy() for field in found.measured)), located.slots.copy())
    with jax.enable_x64(False):
        expected, number = jax.tree.map(np.asarray, CHOOSE(measured, search, setup=setup))
    chosen = ChosenLines(FRAMES, 3, search, setup)
    # Some frames at a time.
    for part in (slice(0, 2), slice(2, 3)):
        chosen.put(part.start, measured._replace(slots=measured.slots[part]))
    assert 0.2 < expected.valid.mean() < 1.0
    for name in FrameStripes._fields:
        np.testing.assert_array_equal(getattr(chosen.stripes, name), getattr(expected, name), err_msg=name)
    if number is None:
        assert chosen.number is None
    else:
        np.testing.assert_array_equal(chosen.number, number)
