"""Tables I and II: their numbers are those of the rig where a calibration is perfect, and count its errors."""

import jax
import numpy as np
import pytest

from experiments.paper import table_1
from experiments.paper.methods import PaperWay
from experiments.paper.products import PAIR_DEG
from experiments.paper.stage import world
from experiments.paper.table_1 import compare_honesty
from jaxscan.geometry import Scanner
from jaxscan.simulation import SimulationConfig, true_scanner


@pytest.fixture(scope="module")
def config() -> SimulationConfig:
    """The paper's rig with a lens of one coefficient, as its model has it."""
    config = world("kind")
    return config.model_copy(update={"camera": config.camera.model_copy(update={"k2": 0.0})})


@pytest.fixture(scope="module")
def perfect(config) -> PaperWay:
    """The paper's calibration without an error."""
    camera, laser, pair = config.camera, config.laser[0], float(np.deg2rad(PAIR_DEG))
    with jax.enable_x64(True):
        tr = np.asarray(true_scanner(config).turntable.tr(pair), np.float64)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    plane = np.array([laser.a, laser.b, laser.c_mm / 1000])
    return PaperWay(matrix, camera.k1, np.zeros((0, 4, 4)), [], plane, plane, tr, pair)


def test_lengths_are_those_of_the_room(config) -> None:
    lengths = table_1.across_half_a_turn(config)
    true = dict(zip((one.key for one in table_1.QUANTITIES), table_1.true_values(config, lengths), strict=True))
    assert true["length_3820"] == pytest.approx(3820, abs=0.5)
    assert true["length_6150"] == pytest.approx(6150, abs=0.5)


def test_a_perfect_calibration_by_the_papers_method_has_no_error(config, perfect) -> None:
    lengths = table_1.across_half_a_turn(config)
    found, true = table_1.of_paper_way(perfect, lengths), table_1.true_values(config, lengths)
    # Single precision at 6 m takes a few micrometres.
    np.testing.assert_allclose(found, true, rtol=2e-6, atol=2e-5)
    for quantity, value in zip(table_1.QUANTITIES, true, strict=True):
        if quantity.paper is not None:
            assert value == pytest.approx(quantity.paper, rel=2e-3)


def test_an_axis_that_is_off_counts_twice_across_half_a_turn(config, perfect) -> None:
    lengths = table_1.across_half_a_turn(config)
    table = true_scanner(config).turntable
    # Farther from the camera along its view by 1 mm.
    point = np.asarray(table.point) + [0, 0, 0.001]
    with jax.enable_x64(True):
        moved = type(table).from_axis(table.direction, point).tr(perfect.pair_angle)
    tr = np.asarray(moved, np.float64)
    change = table_1.of_paper_way(perfect._replace(tr=tr), lengths) - table_1.of_paper_way(perfect, lengths)
    assert change[-2:] == pytest.approx([-2.0, -2.0], abs=0.05)


def drawn(config: SimulationConfig, factor: float, count: int = 40) -> list[Scanner]:
    """Scanners whose errors are `factor` times as large as they state."""
    true, random = true_scanner(config), np.random.default_rng(3)
    size = len(true.parameter_names())
    root = random.normal(size=(size, size)) * np.where(np.arange(size) < 4, 0.02, 1e-6)[:, None]
    found = []
    for _ in range(count):
        with jax.enable_x64(True):
            moved = true.as_dtype(np.float64).retract(factor * root @ random.normal(size=size))
        moved = jax.tree.map(np.asarray, moved)
        found.append(Scanner(moved.camera, moved.lasers, moved.turntable, root @ root.T, true.laser_names, true.up))
    return found


def test_a_bias_counts_as_an_error_and_not_as_spread(config) -> None:
    scanners = drawn(config, 1.0)
    with jax.enable_x64(True):
        step = np.zeros(len(scanners[0].parameter_names()))
        step[0] = 5 * np.sqrt(scanners[0].covariance[0, 0])
        moved = [one.as_dtype(np.float64).retract(step) for one in scanners]
    moved = [
        Scanner(*(jax.tree.map(np.asarray, part) for part in (one.camera, one.lasers, one.turntable)), each.covariance)
        for one, each in zip(moved, scanners, strict=True)
    ]
    biased, unbiased = compare_honesty(moved, config), compare_honesty(scanners, config)
    assert biased.spread == pytest.approx(unbiased.spread, rel=1e-3)
    wanted = np.sqrt(unbiased.pooled**2 + 25 / len(unbiased.names))
    # Twice the product of bias and mean error of 40 draws: 1.6 of the 25, a standard deviation.
    assert biased.pooled == pytest.approx(wanted, rel=0.15)


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_errors_are_compared_with_their_covariance(config, factor) -> None:
    honesty = compare_honesty(drawn(config, factor), config)
    # 40 draws: a mean square of wholly dependent errors has a standard error of 22 %, its root of 11 %.
    assert "gain" not in honesty.names
    assert "fx" in honesty.names
    assert honesty.pooled == pytest.approx(factor, rel=0.25)
    assert honesty.spread == pytest.approx(factor, rel=0.25)
    assert honesty.squared == pytest.approx(factor**2, rel=0.25)
