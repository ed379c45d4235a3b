"""The judge of `experiments/unkind`: its arithmetic on made-up truths with errors that are known."""

import importlib.util

import numpy as np
import pytest

from experiments.unkind import figures, scene, truth
from experiments.unkind.truth import Dimension, Rig, Rows, ray_grid


RECORDS, LINES = 40, 200


def world(rng):
    """A true sheet in a rig, stripes at random places, and no crossing but the first."""
    drawn = scene.draw_rig(rng)
    noise = scene.Sensor()
    true = truth.Truth(
        size=np.array([drawn.width, LINES]),
        lens=drawn.lens,
        normal=drawn.normal,
        distance=np.array(drawn.distance),
        bow=np.zeros(2),
        direction=drawn.direction,
        point=drawn.point,
        angles=np.zeros(RECORDS),
        turned=np.zeros(RECORDS),
        dimensions=np.array([4.0, 4.2]),
        wall_normals=np.eye(3)[[0, 0, 2, 2]] * np.array([1, -1, 1, -1])[:, None],
        wall_distances=np.full(4, -2.0),
        wall_surfaces=np.arange(4),
        panels=np.array([[7, 3]]),
        noise=np.array([noise.electrons_per_dn, noise.read_dn, noise.black_dn, noise.speckle]),
    )
    stripes = truth.empty(RECORDS, LINES)
    stripes.u[..., 0] = rng.uniform(50, 300, (RECORDS, 1)) + 0.1 * np.arange(LINES)
    stripes.amplitude[..., 0] = np.exp(rng.uniform(np.log(6), np.log(240), (RECORDS, LINES)))
    stripes.width[..., 0], stripes.background[..., 0], stripes.surface[..., 0] = 1.2, 30.0, 0
    return true, stripes


def rows_of(stripes, rng, sigma, factor=1.0):
    """Centres with normal errors; `factor` is error over stated."""
    u = stripes.u[..., 0] + factor * sigma * rng.standard_normal((RECORDS, LINES))
    return Rows(u, np.broadcast_to(sigma, u.shape).astype(float), np.ones(u.shape, bool))


def test_a_rig_that_is_right_has_no_error_and_a_turned_sheet_has_its_own():
    rng = np.random.default_rng(1)
    true, _ = world(rng)
    grid = ray_grid(true.size)
    rays = scene.look(true.lens, *grid)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    u, v, points = figures.sheet_grid(true)
    assert len(u) > 10 and np.abs(points[:, 2] - 2.5).max() < 1e-3
    assert np.abs(scene.project(true.lens, points) - np.stack([u, v], -1)).max() < 1e-6
    perfect = Rig(rays, points, true.direction, true.point)
    found = figures.rig_figures(true, perfect, grid)
    # Rays are undone by a fixed point to 1e-9.
    assert all(value < 1e-3 for value in found.values()), found
    # A turn of everything is no error of rays and axis.
    turn = scene.rotation(np.array([0.2, 1.0, 0.1]), 0.01)
    turned = Rig(rays @ turn.T, points, turn @ true.direction, turn @ true.point)
    assert figures.rig_figures(true, turned, grid)["axis_deg"] < 1e-3
    moved = perfect._replace(point=true.point + [0.003, 0, 0], at_row=points * 1.002)
    found = figures.rig_figures(true, moved, grid)
    across = np.linalg.norm(np.cross([0.003, 0, 0], true.direction))
    assert found["axis_mm"] == pytest.approx(1e3 * across, rel=1e-3)
    # Everything is 2 parts in a thousand too far; one pixel moves the point by the slope of the sheet.
    assert found["sheet_mm"] == pytest.approx(2.0 * figures.rms(np.linalg.norm(points, axis=1)), rel=1e-6)
    baseline = np.linalg.norm(drawn_baseline(true))
    expected = found["sheet_mm"] / 1e3 * true.lens[0] * baseline / 2.5**2
    assert found["sheet_px"] == pytest.approx(expected, rel=0.25)


def drawn_baseline(true):
    """Where the sheet meets the camera's x axis [m]."""
    return np.array([true.distance / true.normal[0], 0.0, 0.0])


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_errors_are_compared_with_the_stated_sigma_in_every_class(factor):
    rng = np.random.default_rng(2)
    true, stripes = world(rng)
    found = figures.sweep_figures(true, stripes, rows_of(stripes, rng, 0.1, factor))
    # 8000 draws: the root mean square has a standard deviation of 1 %, in the smallest class (1000) of 2.5 %.
    assert found["rms_px"] == pytest.approx(0.1 * factor, rel=0.04)
    assert found["stated_over_true"] == pytest.approx(1 / factor, rel=0.04)
    for one in found["classes"].values():
        assert one["stated_over_true"] == pytest.approx(1 / factor, rel=0.1)
    assert found["far_share"] < 0.002 and found["found_share"] == 1.0


def test_points_that_are_far_off_and_rows_that_are_missing_are_counted():
    rng = np.random.default_rng(3)
    true, stripes = world(rng)
    rows = rows_of(stripes, rng, 0.05)
    rows.u[:, :20] += 5.0
    rows.valid[:, 20:40] = False
    stripes.edge[:, 10:20] = True
    found = figures.sweep_figures(true, stripes, rows)
    # Of 170 rows that are no edge and have a point, 10 are off; of all 200, 40 are off or missing.
    assert found["far_share"] == pytest.approx(10 / 170, abs=1e-9)
    strong = figures.strong_rows(true, stripes)
    assert found["found_share"] == pytest.approx(strong[:, 40:].sum() / strong.sum(), abs=1e-9)
    # A point where the truth has nothing is far off, too.
    stripes.amplitude[:, 100:110] = 0
    assert figures.sweep_figures(true, stripes, rows)["far_share"] == pytest.approx(20 / 170, abs=1e-9)


def test_the_bound_is_reached_by_the_best_fit_and_by_no_other():
    """With a known width and amplitude a matched fit has the bound's variance; the closed form has no pixels."""
    true, _ = world(np.random.default_rng(4))
    bright = figures.row_bound(true, np.array([50.0]), np.array([1.3]), np.array([10.0]))[0]
    # Gaussian stripe in even noise: variance = 2 w sigma^2 / (sqrt(pi) A^2), here without the stripe's own noise.
    quiet = true._replace(noise=np.array([1e9, 1.7, 5.0, 0.0]))
    found = figures.row_bound(quiet, np.array([50.0]), np.array([1.3]), np.array([0.0]))[0]
    sigma = np.sqrt(2 * (1.7**2 + 1 / 12))
    # The pixel widens the stripe to sqrt(1.3^2 + 1/12) and lowers its peak alike.
    wide = np.hypot(1.3, np.sqrt(1 / 12))
    peak = 50.0 * 1.3 / wide
    assert found == pytest.approx(sigma / peak * np.sqrt(2 * wide / np.sqrt(np.pi)), rel=0.01)
    assert bright > found
    speckled = true._replace(noise=np.array([8.0, 1.7, 5.0, 0.2]))
    assert figures.row_bound(speckled, np.array([50.0]), np.array([1.3]), np.array([10.0]))[0] > 1.1 * bright


def test_classes_of_the_print_have_figures_of_their_own():
    rng = np.random.default_rng(5)
    _, stripes = world(rng)
    stripes.contrast[..., 0] = np.repeat([0.02, 0.3, 0.9], [70, 70, 60])
    rows = rows_of(stripes, rng, 0.1)
    rows.u[:, 140:] += 2 * (rows.u - stripes.u[..., 0])[:, 140:]
    found = figures.board_figures(stripes, rows)
    slant = np.hypot(1, 0.1)
    expected = {"none": 1 / slant, "weak": 1 / slant, "black and white": 3 / slant}
    for name, value in expected.items():
        assert found["classes"][name]["error_over_stated"] == pytest.approx(value, rel=0.05), name
    # Beside the board nothing counts.
    stripes.contrast[:, :70] = np.nan
    assert figures.board_figures(stripes, rows)["classes"]["none"]["points"] == 0


def test_the_width_of_a_step_is_that_of_its_blur():
    rng = np.random.default_rng(6)
    true, stripes = world(rng)
    stripes.surface[:, :100, 0], stripes.surface[:, 100:, 0] = 3, 7
    stripes.u[:, 100:, 0] += 1.6
    from scipy.special import ndtr

    edge = np.arange(LINES) - 99.5
    for sigma in (0.8, 1.6):
        u = stripes.u[..., 0].copy()
        u += 1.6 * (ndtr(edge / sigma) - (edge > 0))
        found = figures.step_width(true, stripes, Rows(u, np.ones_like(u), np.ones(u.shape, bool)))
        # 10 to 90 % of a normal distribution; between rows the curve is taken for straight.
        assert found["rows"] == pytest.approx(2.563 * sigma, abs=0.15)
        assert found["profiles"] == RECORDS


def test_walls_and_limits():
    found = figures.dimension_figures([Dimension(4.003, 0.001, 4.0), Dimension(4.199, 0.001, 4.2)], 2)
    assert found["within_two"] == 0.5 and found["errors_mm"] == pytest.approx([3.0, -1.0])
    assert figures.dimension_figures([Dimension(4.199, 0.001, 4.2)], 2)["within_two"] == 0.5
    rival = {"rig": {"rays_px": 0.5}}
    assert figures.worse({"rig": {"rays_px": float("nan")}}, rival) == ["rays [px] nan against 0.5"]
    assert figures.worse({"rig": {"rays_px": 0.4}}, rival) == [] == figures.worse({}, {})
    limit = figures.Limit("x", ("a", "classes"), 0.9, 1.1, True, "r")
    measured = {"a": {"classes": {"one": {"r": 1.0}, "two": {"r": 1.2}, "three": {"r": float("nan")}}}}
    assert figures.broken(measured, limit) == ["two: 1.2"]
    assert figures.values(measured, limit) == {"one": 1.0, "two": 1.2}


def test_speckle_on_a_pixel_has_the_contrast_that_was_asked_for_and_is_alone_in_its_grain():
    chip = scene.Sensor(speckle=0.2)
    spots = scene.Speckle(chip, (128, 160), np.random.default_rng(7))
    pixels = scene.to_pixels(spots.draw((128 * scene.FINE, 160 * scene.FINE)), scene.FINE)
    assert pixels.mean() == pytest.approx(1.0, abs=0.01)
    assert pixels.std() == pytest.approx(0.2, rel=0.05)
    # A grain is 0.75 px wide: a pixel three away is another draw.
    apart = np.corrcoef(pixels[:, :-3].ravel(), pixels[:, 3:].ravel())[0, 1]
    assert abs(apart) < 0.03


def test_a_stripe_whose_middle_is_hidden_is_an_edge_and_no_row_to_be_found():
    stripes = truth.TrueStripes(*(part[0] for part in truth.empty(1, 3)))
    stripes.u[:2, 0], stripes.amplitude[:2, 0], stripes.surface[:2, 0] = 20.0, 50.0, 0
    light = np.zeros((3, 60))
    light[:, 18:23] = 30.0
    light[1, 40] = 5.0
    found = truth.with_parts(stripes, light)
    assert found.u[:, -1].tolist() == [0.0, 40.0, 18.0] and found.edge[:, -1].tolist() == [False, True, True]
    true, _ = world(np.random.default_rng(8))
    assert figures.strong_rows(true, found).tolist() == [True, True, False]


@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="Mitsuba is not installed (extra 'worlds')")
def test_a_path_traced_board_shows_its_stripe_where_the_truth_says():
    from experiments.unkind import path_traced
    from experiments.unkind.tracer import Shot, Tracer, crossings, print_contrast

    drawn = path_traced.draw_world(3)
    views = path_traced.draw_views(drawn.rig, drawn.board, drawn.room.camera, drawn.rng)
    place = drawn.board.patch(views[4].room_board)
    tracer = Tracer(drawn.room, 3, place)
    shot = Shot(drawn.rig, tracer, drawn.room.camera)
    middle = tracer.cast(shot.pose[:3, 3], shot.turned(path_traced.ways(drawn.rig)))
    on_board = middle.shape == tracer.board
    assert 0.05 < on_board.mean() < 0.6
    found = crossings(shot, middle)
    # The middle of the sheet, the surface and the pixel's ray meet in a point.
    seen = scene.project(drawn.rig.lens, shot.local(found.p))
    assert np.abs(seen - np.stack([found.u, found.row], -1)).max() < 2e-3
    assert np.abs(shot.beside(found.p)).max() < 1e-4
    contrast = print_contrast(shot, *(part[found.shape == tracer.board] for part in (found.u, found.row)))
    assert (contrast > 0.5).sum() > 20 and (contrast < 0.1).sum() > 5
