"""Plans and sections of a furnished room: what is drawn, and where."""

from dataclasses import replace

import numpy as np
import pytest

import jaxscan
from jaxscan.drawing import LAYERS, border, lay_out, strokes
from jaxscan.drawing.contours import simplified
from jaxscan.errors import MeasurementError
from jaxscan.measurement.outline.corners import Surface

from ..measurement.rooms import CUPBOARD, HEIGHT, seen_room


def on(drawing, layer):
    return [line.points for line in drawing.lines if line.layer == layer]


def test_dimensions_are_the_lengths_that_were_measured(survey):
    plan = jaxscan.draw_plan(survey, heights_m=[1.0])
    assert {one.layer for one in plan.dimensions} == {"A-ANNO-DIMS"}
    outside = [one for one in plan.dimensions if one.offset_m < 0.0]
    for found in survey.outline.lengths(1.0)[0]:
        assert any(
            one.length_m == pytest.approx(found.value, abs=1e-5) and one.words.startswith(f"{found.value:.3f} m ±")
            for one in outside
        )
    # Through the room: both arms of the L are 6 and 5 m long.
    inner = sorted(one.length_m for one in plan.dimensions if one.offset_m == 0.0)
    np.testing.assert_allclose(inner, [5.0, 6.0], atol=1e-3)


def test_walls_have_gaps_where_door_and_window_are(survey):
    plan = jaxscan.draw_plan(survey, heights_m=[1.0])
    drawn = sum(np.linalg.norm(line[1] - line[0]) for line in on(plan, "A-WALL"))
    found = [one for loop in survey.openings for side in loop for one in side]
    widths = [one.width.value for one in found]
    # And two jambs of each, as long as the grey behind the wall is wide.
    jambs = 2 * len(found) * 2e-3 * plan.sheet.scale
    assert drawn == pytest.approx(22.0 - sum(widths) + jambs, abs=5e-3)
    assert len(on(plan, "A-DOOR")) == 1 and len(on(plan, "A-GLAZ")) == 3
    above = jaxscan.draw_plan(survey, heights_m=[2.3])
    assert "A-DOOR" not in above.layers and "A-GLAZ" not in above.layers


def test_a_door_swings_by_a_quarter_of_its_width(survey):
    plan = jaxscan.draw_plan(survey)
    (leaf,) = on(plan, "A-DOOR")
    (door,) = [one for loop in survey.openings for side in loop for one in side if one.kind == "door"]
    swing = next(line for line in on(plan, "A-DOOR-SWNG") if len(line) > 2)
    assert np.linalg.norm(leaf[1] - leaf[0]) == pytest.approx(door.width.value)
    np.testing.assert_allclose(np.linalg.norm(swing - leaf[0], axis=1), door.width.value, rtol=1e-12)
    np.testing.assert_allclose(swing[-1], leaf[1], atol=1e-12)
    assert (swing[0] - leaf[0]) @ (leaf[1] - leaf[0]) == pytest.approx(0.0, abs=1e-9)
    # Into the room.
    assert survey.is_inside(swing[1:-1]).sum() >= 20
    assert "convention" in LAYERS["A-DOOR"].means


def test_chains_of_dimensions_add_up(survey):
    """The pieces of a wall and its openings, in a row outside of it, are as long as the wall."""
    plan = jaxscan.draw_plan(survey)
    row = max(one.offset_m for one in plan.dimensions if one.offset_m < 0.0)
    pieces = [one for one in plan.dimensions if one.offset_m == row]
    whole = [one for one in plan.dimensions if one.offset_m == 2.0 * row]
    assert len(whole) == 2
    for wall in whole:
        along = (wall.end - wall.start) / wall.length_m
        across = np.array([-along[1], along[0]])
        on_it = [
            one for one in pieces if np.abs(np.stack([one.start, one.end]) @ across - wall.start @ across).max() < 1e-6
        ]
        assert len(on_it) == 3 and sum(one.length_m for one in on_it) == pytest.approx(wall.length_m, abs=1e-9)


@pytest.mark.parametrize("scale", [50, 100])
def test_no_label_covers_another(survey, scale):
    plan = jaxscan.draw_plan(survey, sheet=jaxscan.Sheet("a3", scale=scale, room="Living room"))
    boxes = [text.box() for text in strokes(plan)[1]]
    for i, one in enumerate(boxes):
        for other in boxes[:i]:
            assert not ((one.min(0) < other.max(0)) & (other.min(0) < one.max(0))).all()


def test_the_room_has_its_name_and_its_area_within(survey):
    plan = jaxscan.draw_plan(survey, sheet=jaxscan.Sheet(room="Kitchen"))
    (name,) = [text for text in plan.texts if text.words == "Kitchen"]
    (area,) = [text for text in plan.texts if text.words.endswith(" m²")]
    assert area.words.startswith(f"{survey.outline.floor_area().value:.3f} ±")
    assert survey.is_inside(np.stack([name.at, area.at])).all()


def test_furniture_is_grey_where_it_was_seen_from_above():
    """A table lower than the scanner, whose top is 1.6 m x 0.8 m."""
    room = ((0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0))
    survey = jaxscan.survey_room(seen_room(room, boxes=(((2.8, 1.4, 0.0), (4.4, 2.2, 0.7)),)))
    (area,) = [one.points for one in jaxscan.draw_plan(survey).areas if one.layer == "A-FURN-PATT"]
    sides = np.sort(np.ptp(area, axis=0))
    # Rays are up to 6 cm apart, and a pixel is 2 cm.
    np.testing.assert_allclose(sides, [0.8, 1.6], atol=0.12)


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
        axis = 8e-3 * drawing.sheet.scale
        assert [line for line in symbols if len(line) == 2 and np.allclose(line, [[0, 0], [axis, 0]])]
        words = [text.words for text in drawing.texts if text.layer == "A-ANNO-SYMB"]
        assert {"0", *names} <= set(words)
        page = lay_out(drawing)
        boxes = [line.points for line in page.lines if line.layer == "A-ANNO-TTLB" and len(line.points) == 5]
        # A quarter of the scale bar.
        assert any(np.allclose(np.ptp(box, axis=0), [500.0 / drawing.sheet.scale, 1.2]) for box in boxes)
        assert {"1", "2 m"} <= {text.words for text in page.texts}


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
    whole = {f"{found.value:.3f} m" for found in survey.outline.lengths(1.0)[0]}
    assert not whole & {one.value for one in plan.dimensions}


def test_what_contradicts_a_wall_is_said(survey):
    outline = replace(survey.outline, remarks=("W3 is no wall: its plane at 2.00 m has 30 % of the points behind it",))
    contradicted = replace(survey, outline=outline)
    for drawing in (
        jaxscan.draw_plan(contradicted, heights_m=[1.0]),
        jaxscan.draw_section(contradicted, (-1.0, 1.0), (4.0, 1.0)),
    ):
        said = f"{outline.remarks[0]}."
        assert said in drawing.remarks and said in " ".join(text.words for text in border(drawing).texts)
