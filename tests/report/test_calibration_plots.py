"""The numbers behind the figures of the report."""

import dataclasses
import re

import matplotlib as mpl
import numpy as np
import pytest

from jaxscan.calibration.result import BoardMap
from jaxscan.geometry import Chessboard
from jaxscan.report import plots
from jaxscan.report.drawing import as_svg, plain
from jaxscan.report.html import Html, element, escaped, table
from jaxscan.report.plots import board_map


def test_whitened_residuals_of_noise_are_a_unit_gaussian(calibration):
    for values in plots.whitened_residuals(calibration.fit).values():
        # At least 238 values: the standard deviation of theirs is 4.6 %, four of which are 0.18.
        assert np.std(values) == pytest.approx(1.0, abs=0.18)


def test_whitened_residuals_are_those_kept_and_not_all_taken_up_by_the_fit(calibration):
    leverage = calibration.fit.corner_leverage.copy()
    leverage[0, 0, 0] = 1.0
    found = plots.whitened_residuals(dataclasses.replace(calibration.fit, corner_leverage=leverage))
    assert len(found["corners"]) == 2 * (6 * 20 - 1) - 1
    none = np.zeros_like(calibration.fit.stripe_inlier)
    assert list(plots.whitened_residuals(dataclasses.replace(calibration.fit, stripe_inlier=none))) == ["corners"]


def test_means_of_cells_are_clear_where_there_is_more_than_noise():
    random = np.random.default_rng(2)
    q = random.uniform(0, 1200, (20_000, 2))
    error = 0.1 * random.normal(size=q.shape)
    error[(q < 100).all(1)] += (0.05, -0.03)
    middle, mean, clear = plots.cell_means(q, error, np.full(len(q), 0.1), 1200, 1200)
    assert len(middle) == 144
    corner = int(np.flatnonzero((middle == 50).all(1))[0])
    # 139 points: the mean is known to 0.1 / sqrt(139) = 0.0085, four of which are 0.034.
    np.testing.assert_allclose(mean[corner], (0.05, -0.03), atol=0.034)
    # One in a hundred of the others, by chance: six of 143 happen once in 400 draws.
    assert clear[corner] and clear.sum() <= 6


def test_means_of_pieces():
    x = np.linspace(0, 100, 5000)
    middle, mean, noise = plots.binned(x, 2 * x)
    # A straight line has its mean in the middle of each piece, but for the spacing of the samples.
    np.testing.assert_allclose(mean, 2 * middle, atol=0.05)
    # Within a piece of width w = 100 / 28 the line spreads by 2 w / sqrt(12); 178 points each.
    np.testing.assert_allclose(noise, 2 * 100 / 28 / np.sqrt(12 * 178), rtol=0.02)


@pytest.mark.parametrize(("usual", "scale"), [(0.13, 0.2), (0.021, 0.05), (4.9, 5.0), (7.0, 10.0), (0.0, 1.0)])
def test_the_scale_of_arrows_is_a_round_number(calibration, usual, scale):
    error = np.zeros_like(calibration.fit.corner_error)
    error[..., 0] = usual
    assert plots.residual_scale(dataclasses.replace(calibration.fit, corner_error=error)) == pytest.approx(scale)


def test_stripes_along_columns_or_rows(calibration):
    observations = calibration.observations
    assert plots.stripe_direction(observations) == 1
    turned = dataclasses.replace(observations.stripes, q=observations.stripes.q[..., ::-1])
    assert plots.stripe_direction(dataclasses.replace(observations, stripes=turned)) == 0


def test_combinations_are_named_by_their_largest_parts():
    assert plots.combination({"fx": -0.7, "fy": -0.6, "k1": 0.01, "d": 0.4}) == "fx + fy − d"
    assert plots.combination({}) == "—"


def test_figures_keep_no_name_twice_and_show_text_as_text(calibration):
    first, second = (as_svg(plots.histogram(np.arange(-3.0, 3.0, 0.01)), name, "a <b> & c") for name in ("one", "two"))
    assert ">unit Gaussian</text>" in first
    assert 'aria-label="a &lt;b&gt; &amp; c"' in first
    names = [set(re.findall(r' id="([^"]*)"', svg)) for svg in (first, second)]
    assert names[0] and not names[0] & names[1]
    assert set(re.findall(r'#([^")]*)[")]', first)) & names[0] == names[0]


def test_the_same_bytes_again_and_no_global_state_touched(calibration):
    before = dict(mpl.rcParams)
    twice = {as_svg(plots.along_stripe(calibration.observations, calibration.fit), "a", "b") for _ in "ab"}
    assert len(twice) == 1
    assert dict(mpl.rcParams) == before


def test_names_that_figures_can_show():
    assert plain("laser ß") == "laser ß"
    assert plain("\u4e00\n\u202e") == "???"
    assert plain("x" * 40) == "x" * 27 + "…"


def test_text_is_escaped_and_markup_is_not():
    assert escaped("<a & 'b'>\x07") == "&lt;a &amp; &#x27;b&#x27;&gt; "
    assert element("p", "<i>", Html("<i></i>"), class_='"x') == '<p class="&quot;x">&lt;i&gt;<i></i></p>'
    assert "<td>&lt;b&gt;</td>" in table(["<h>"], [["<b>"]]) and "<th>&lt;h&gt;</th>" in table(["<h>"], [])


BOARD = Chessboard(columns=4, rows=3, square=0.03)
"""Of 12 corners."""


def numbers_on_the_map(heights_m, sigma_m):
    """What is written on the map of a board: the numbers of its corners, and the title of the colours."""
    shift = ((0.0, 0.0),) * len(heights_m)
    found = BoardMap("bent", 0.0, None, None, tuple(heights_m), (sigma_m,) * len(heights_m), shift)
    figure = board_map(found, BOARD.corners(), BOARD.square)
    axes, bar = figure.axes
    return [text.get_text() for text in axes.texts], bar.get_ylabel(), axes.collections[0].get_clim()


def test_heights_of_a_board_are_written_with_as_many_digits_as_they_have():
    heights = np.linspace(-0.55e-3, 0.55e-3, 12)
    numbers, title, limits = numbers_on_the_map(heights, 0.01e-3)
    assert title == "height into the board, mm" and limits == pytest.approx((-0.55, 0.55))
    assert numbers[0] == "-0.55" and numbers[-1] == "+0.55"
    numbers, title, limits = numbers_on_the_map(1e-2 * heights, 0.1e-6)
    assert title == "height into the board, µm" and limits == pytest.approx((-5.5, 5.5))
    assert numbers[0] == "-5.5" and numbers[-1] == "+5.5"


def test_heights_that_are_noise_are_pale_and_have_no_sign_of_their_own():
    numbers, title, limits = numbers_on_the_map([0.0, -4e-8, *[1e-6] * 10], 2e-6)
    assert title == "height into the board, µm" and limits == pytest.approx((-6.0, 6.0))
    assert numbers[:3] == ["0.0", "0.0", "+1.0"]
