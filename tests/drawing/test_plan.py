"""Plans and sections of a furnished room: what is drawn, and where."""

from dataclasses import replace

import numpy as np
import pytest

import jaxscan
from jaxscan.drawing.contours import simplified
from jaxscan.errors import MeasurementError
from jaxscan.measurement.outline.corners import Surface

from ..measurement.rooms import CUPBOARD, HEIGHT, seen_room


def on(drawing, layer):
    return [line.points for line in drawing.lines if line.layer == layer]


def test_dimensions_are_the_lengths_that_were_measured(survey):
    plan = jaxscan.draw_plan(survey, heights_m=[1.0])
    assert {one.layer for one in plan.dimensions} == {"A-ANNO-DIMS"}
    walls = [one for one in plan.dimensions if one.offset_m == -0.5]
    for one, found in zip(walls, survey.outline.lengths(1.0)[0], strict=True):
        assert one.length_m == pytest.approx(found.value, abs=1e-5)
        assert one.words.startswith(f"{found.value:.3f} m ±")
    # Through the room: both arms of the L are 6 and 5 m long.
    inner = sorted(one.length_m for one in plan.dimensions if one.offset_m == 0.0)
    np.testing.assert_allclose(inner, [5.0, 6.0], atol=1e-3)


def test_walls_have_gaps_where_door_and_window_are(survey):
    plan = jaxscan.draw_plan(survey, heights_m=[1.0])
    drawn = sum(np.linalg.norm(line[1] - line[0]) for line in on(plan, "A-WALL"))
    widths = [one.width.value for loop in survey.openings for side in loop for one in side]
    assert drawn == pytest.approx(22.0 - sum(widths), abs=5e-3)
    assert on(plan, "A-DOOR") and len(on(plan, "A-GLAZ")) == 2
    above = jaxscan.draw_plan(survey, heights_m=[2.3])
    assert "A-DOOR" not in above.layers and "A-GLAZ" not in above.layers


def test_furniture_is_where_it_stands(survey):
    """Its two sides that face the scanner, at heights at which it is."""
    plan = jaxscan.draw_plan(survey, heights_m=[1.0, 2.2])
    assert [name for name in plan.layers if name.startswith("A-FURN")] == ["A-FURN-100"]
    (outline,) = on(plan, "A-FURN-100")
    # The plan is turned against the room by right angles, so lengths are compared: 1.2 m of front, 0.5 m of side.
    length = np.linalg.norm(np.diff(outline, axis=0), axis=1).sum()
    deep, wide = CUPBOARD[1][1] - CUPBOARD[0][1], CUPBOARD[1][0] - CUPBOARD[0][0]
    # Rays are 7 cm apart there, and what is nearer than 6 cm to the wall is taken for the wall.
    assert wide + deep - 0.25 < length < wide + deep + 0.05


def test_a_section_is_as_wide_and_high_as_the_room(survey):
    corners = np.array([corner.at[:2] for corner in survey.outline.corners()[0]])
    middle = corners.mean(0)
    section = jaxscan.draw_section(survey, (0.7, float(middle[1])), (0.7, float(middle[1]) + 1.0))
    heights = [one.length_m for one in section.dimensions if one.offset_m == 0.0]
    np.testing.assert_allclose(heights, HEIGHT, atol=1e-4)
    (floor,), (ceiling,) = on(section, "A-FLOR"), on(section, "A-CLNG")
    np.testing.assert_allclose(floor[:, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(ceiling[:, 1], HEIGHT, atol=1e-3)
    width = np.linalg.norm(floor[1] - floor[0])
    assert min(abs(width - each) for each in (5.0, 6.0, 2.5, 3.5)) < 1e-3
    assert [one.length_m for one in section.dimensions if one.offset_m != 0.0] == [pytest.approx(width)]


def test_origin_axes_and_scale_bar_are_drawn(survey):
    """Where a section is chosen, and how long a metre is, is in the drawing."""
    for drawing, names in ((jaxscan.draw_plan(survey), "xy"), (jaxscan.draw_section(survey, (0.7, 1), (0.7, 2)), ())):
        symbols = on(drawing, "A-ANNO-SYMB")
        assert [line for line in symbols if len(line) == 2 and np.allclose(line, [[0, 0], [0.4, 0]])]
        assert [line for line in symbols if np.allclose(np.ptp(line, axis=0), [1.0, 0.0])]
        words = [text.words for text in drawing.texts if text.layer == "A-ANNO-SYMB"]
        assert {"0", "0.5", "1 m", *names} <= set(words)


def test_a_room_with_a_pillar_is_cut_twice():
    """The pillar, as high as the room, divides a section through it."""
    cloud = seen_room(
        ((0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)), boxes=(((3.5, 2.0, 0.0), (4.5, 3.0, HEIGHT)),), grid=(720, 80)
    )
    survey = jaxscan.survey_room(cloud)
    plan = jaxscan.draw_plan(survey)
    assert all(np.isfinite(line.points).all() for line in plan.lines)
    # Behind the pillar nobody saw anything: whatever is said of it has no dimension.
    assert all(one.length_m < 6.1 for one in plan.dimensions)


def test_refusals(survey, furnished_cloud):
    for height in (0.0, -1.0, 2.7, 1e30, np.nan):
        with pytest.raises(MeasurementError, match="Height"):
            jaxscan.draw_plan(survey, heights_m=[height])
    with pytest.raises(MeasurementError, match="does not meet the room"):
        jaxscan.draw_section(survey, (20.0, 0.0), (20.0, 1.0))
    with pytest.raises(MeasurementError, match="are one"):
        jaxscan.draw_section(survey, (1.0, 1.0), (1.0, 1.0))
    single = type(furnished_cloud)(**vars(furnished_cloud))
    for name in ("xyz", "rgb", "sigma_random", "valid"):
        values = getattr(single, name)
        setattr(single, name, values.reshape(1, -1, *values.shape[2:]))
    single.laser, single.angle = single.laser[:1], single.angle[:1]
    with pytest.raises(MeasurementError, match="neighbours"):
        jaxscan.survey_room(single)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda cloud: cloud.sigma_random.fill(0.0), "no sigmas"),
        (lambda cloud: cloud.sigma_random.fill(np.nan), "no sigmas"),
        (lambda cloud: cloud.xyz.fill(1e30), "coordinates"),
        (lambda cloud: cloud.xyz.__setitem__((3, 3), np.nan), "coordinates"),
        (lambda cloud: cloud.valid.fill(False), "no valid points"),
    ],
)
def test_clouds_of_which_nothing_can_be_said(change, said):
    cloud = seen_room(grid=(90, 30))
    change(cloud)
    with pytest.raises(MeasurementError, match=said):
        jaxscan.survey_room(cloud)
    with pytest.raises(MeasurementError, match=said):
        jaxscan.measure_points(cloud, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])


def test_a_single_point():
    cloud = seen_room(grid=(90, 30))
    cloud.valid[:] = False
    cloud.valid[4, 4] = True
    with pytest.raises(MeasurementError, match="No floor"):
        jaxscan.survey_room(cloud)


def test_simplified_lines_stay_within_the_tolerance():
    t = np.linspace(0.0, 2.0, 400)
    line = np.stack([t, 0.2 * np.sin(4.0 * t)], 1)
    short = simplified(line, 0.01)
    assert len(short) < 40 and (short[[0, -1]] == line[[0, -1]]).all()
    assert np.abs(np.interp(t, short[:, 0], short[:, 1]) - line[:, 1]).max() < 0.02
    straight = simplified(np.stack([t, 3.0 * t], 1))
    assert len(straight) == 2


def test_a_section_within_a_wall_is_moved_before_it(survey):
    """Through 0 of the plan, along both walls that meet there; the wall it would run in has no place in it."""
    for a, b in (((-1.0, 0.0), (2.0, 0.0)), ((0.0, -2.0), (0.0, 2.0))):
        section = jaxscan.draw_section(survey, a, b)
        (remark,) = section.remarks
        assert "moved by 8 cm into the room" in remark
        widths = [one.length_m for one in section.dimensions if one.offset_m != 0.0]
        assert widths and all(min(abs(one - each) for each in (2.5, 3.5, 5.0, 6.0)) < 5e-3 for one in widths)
    assert not jaxscan.draw_section(survey, (0.7, 1.0), (0.7, 2.0)).remarks


def test_what_is_not_known_is_no_dimension(survey):
    """Walls whose places are known to metres: their lengths are left out, and the drawing says how many."""

    def vague(side):
        wall = side.surface.wall
        plane = wall.plane._replace(covariance=np.eye(3) * 4.0)
        return replace(side, surface=Surface(plane, wall._replace(plane=plane)))

    loops = tuple(tuple(vague(side) for side in loop) for loop in survey.outline.loops)
    unknown = replace(survey, outline=replace(survey.outline, loops=loops))
    plan = jaxscan.draw_plan(unknown)
    assert any("left out" in remark for remark in plan.remarks)
    assert not [one for one in plan.dimensions if one.offset_m == -0.5]


def test_what_contradicts_a_wall_is_said(survey):
    outline = replace(survey.outline, remarks=("W3 is no wall: its plane at 2.00 m has 30 % of the points behind it",))
    contradicted = replace(survey, outline=outline)
    for drawing in (
        jaxscan.draw_plan(contradicted, heights_m=[1.0]),
        jaxscan.draw_section(contradicted, (-1.0, 1.0), (4.0, 1.0)),
    ):
        said = f"{outline.remarks[0]}."
        assert said in drawing.remarks and said in [text.words for text in drawing.texts]
