"""What is measured by a click is what `jaxscan measure` says, to the last digit."""

import csv
import dataclasses
import io
import json

import numpy as np
import pytest

import jaxscan
from jaxscan.errors import MeasurementError
from jaxscan.viewer import Named, View
from jaxscan.viewer.measuring import (
    as_csv,
    as_json,
    measure_flatness,
    measure_pair,
    measure_point,
    measure_sides,
)
from jaxscan.viewer.orders import Order, Ray
from jaxscan.viewer.session import Session, Work
from jaxscan.viewer.shown import ShownCloud

from ..cli.conftest import run as run


@pytest.fixture(scope="module")
def shown(tiny):
    words = {"calibration": f"-c {tiny.calibration}"}
    return ShownCloud(str(tiny.cloud), jaxscan.load_cloud(tiny.cloud), np.array([1.0, -2.0, 0.0]), words=words)


@pytest.fixture(scope="module")
def flat(shown):
    """Places around which there are points enough, of two walls."""
    counts = [(np.abs(shown.xyz - place) < 0.05).all(1).sum() for place in shown.xyz[::97]]
    return shown.xyz[::97][np.argsort(counts)[::-1]] + shown.origin


def carry_out(session, order):
    """What the page shows after an order."""
    answer = session.begin(order)
    return session.finish(answer) if isinstance(answer, Work) else answer


def distant(flat):
    """Two of them that are far apart."""
    return flat[0], flat[np.argmax(np.linalg.norm(flat[:40] - flat[0], axis=1))]


@pytest.mark.parametrize("calibrated", [False, True])
def test_a_distance(tiny, shown, flat, run, calibrated):
    scanner = jaxscan.load_scanner(tiny.calibration) if calibrated else None
    found = measure_pair("distance", shown, *distant(flat), scanner)
    ran = run(*(found if calibrated else found._replace(options={})).command().split()[1:])
    assert ran.code == 0 and ran.out.splitlines() == list(found.words)
    assert found.sigma_m > 0


def test_flatness(shown, flat, run):
    found = measure_flatness(shown, flat[0])
    ran = run(*found.command().split()[1:])
    assert ran.code == 0 and ran.out.split() == " ".join(found.words).split()
    normal = found.words[0].partition("normal ")[2].split()
    assert [len(one.lstrip("-")) for one in normal] == [6, 6, 6] and "-0.0000" not in normal
    assert np.array(normal, float) == pytest.approx(found.plane.normal, abs=5.1e-5)


def test_the_room(tiny, shown, run, tmp_path):
    scanner = jaxscan.load_scanner(tiny.calibration)
    sides = measure_sides(shown, scanner)
    ran = run(*sides[0].command().split()[1:], "--json", tmp_path / "room.json")
    assert ran.code == 0
    printed = json.loads((tmp_path / "room.json").read_text())
    assert [side.value_m for side in sides] == [printed[name]["value_m"] for name in ("length", "width", "height")]
    assert [side.sigma_m for side in sides] == [printed[name]["sigma_m"] for name in ("length", "width", "height")]


def test_the_list_says_why_a_dimension_is_left_out(shown, monkeypatch):
    """As the terminal and the report do."""
    remark = "31 % of the points lie behind a plane at 2.00 m"
    whole = jaxscan.measure_room(shown.cloud)
    part = dataclasses.replace(whole, height=None, remarks=(remark,))
    monkeypatch.setattr("jaxscan.viewer.measuring.measure_room", lambda cloud, scanner: part)
    session = Session([shown], None)
    state = carry_out(session, Order("room", shifts=((0, np.zeros(3)),)))
    assert [len(one["words"]) for one in state["measured"]] == [1, 2]
    assert state["measured"][-1]["words"][-1] == f"a dimension is left out: {remark}."
    for saved in ("csv", "json"):
        assert remark in carry_out(session, Order("save", saved))["text"]


def test_a_point_is_one_of_the_file(shown):
    found = measure_point(shown, 5)
    place = np.asarray(shown.cloud.xyz).reshape(-1, 3)[shown.cells[5]]
    np.testing.assert_allclose(found.at[0], place, atol=5.1e-5)
    parts = shown.cloud.sigma_random, shown.cloud.sigma_systematic
    sigma = np.hypot(*(np.asarray(part).reshape(-1)[shown.cells[5]] for part in parts))
    assert f"sigma {1e3 * sigma:.2f} mm" in found.words[0]


def test_lists_can_be_read_back_and_hold_no_formula(shown, flat):
    bad = ShownCloud("=cmd()", shown.cloud, np.zeros(3))
    measured = [measure_pair("distance", shown, *distant(flat), None), measure_point(bad, 0)]
    rows = list(csv.DictReader(io.StringIO(as_csv(measured).decode())))
    assert float(rows[0]["value_m"]) == pytest.approx(measured[0].value_m, abs=1e-6)
    assert rows[1]["cloud"] == "'=cmd()" and rows[1]["x2_m"] == ""
    read = json.loads(as_json(measured))
    assert read["measured"][0]["value_m"] == measured[0].value_m
    assert read["measured"][1]["at_m"] == measured[1].at.tolist()


def test_what_nobody_knows_is_left_empty(shown, flat):
    """A point has no length and flatness no sigma: neither is 0."""
    host = shown.cloud
    none = np.zeros_like(host.sigma_random)
    unknown = ShownCloud("a", dataclasses.replace(host, sigma_random=none, sigma_systematic=none), shown.origin)
    measured = [measure_point(shown, 5), measure_point(unknown, 5), measure_flatness(shown, flat[0])]
    measured += measure_sides(shown, None)
    rows = list(csv.DictReader(io.StringIO(as_csv(measured).decode())))
    assert [row["what"] for row in rows] == ["", "", "RMS", "length", "width", "height"]
    assert [bool(row["value_m"]) for row in rows] == [False, False, True, True, True, True]
    assert [bool(row["sigma_m"]) for row in rows] == [True, False, False, True, True, True]
    read = json.loads(as_json(measured))["measured"]
    assert read[1]["sigma_m"] is None and read[0]["value_m"] is None and read[2]["sigma_m"] is None


def test_the_rooms_lengths_are_drawn_from_wall_to_wall(shown):
    for side in measure_sides(shown, None):
        assert np.linalg.norm(side.at[1] - side.at[0]) == pytest.approx(side.value_m, abs=2e-4)
        direction = (side.at[1] - side.at[0]) / side.value_m
        along = (shown.xyz + shown.origin) @ direction
        # Nothing is behind the walls but the worst points, 26 mm off in this cloud.
        assert (along.min(), along.max()) == pytest.approx(tuple(side.at @ direction), abs=0.06)


def ray_to(shown, place):
    """From the middle of the cloud to a place of it, in the frame of the scene."""
    origin = -shown.origin
    return Ray(origin, place - shown.origin - origin, 0.01)


def test_a_page_measures_undoes_and_saves(tiny, shown, flat):
    session = Session([shown], None)
    shifts = ((0, np.zeros(3)),)
    a, b = distant(flat)
    carry_out(session, Order("choose", "distance"))
    state = carry_out(session, Order("pick", ray=ray_to(shown, a), shifts=shifts))
    assert len(state["places"]) == 1 and not state["measured"] and "other place" in state["message"]
    state = carry_out(session, Order("pick", ray=ray_to(shown, b), shifts=shifts))
    assert state["places"] == [] and len(state["measured"]) == 1
    # In the frame of the scene, for the page to draw.
    drawn = [np.array(end["xyz"]) + shown.origin for end in state["measured"][0]["at"]]
    assert np.linalg.norm(drawn[1] - drawn[0]) == pytest.approx(session.measured[0][1].value_m, abs=0.03)
    assert json.loads(carry_out(session, Order("save", "json"))["text"])["measured"][0]["kind"] == "distance"
    assert carry_out(session, Order("undo"))["measured"] == []


def test_entries_are_taken_out_by_their_ids(shown, flat):
    session = Session([shown, shown], None)
    shifts = ((0, np.zeros(3)), (1, np.zeros(3)))
    both = carry_out(session, Order("room", shifts=shifts))["measured"]
    assert [one["cloud"] for one in both] == [0, 0, 0, 1, 1, 1]
    again = Order("remove", id=both[1]["id"])
    carry_out(session, again)
    # A cross that is pressed twice takes one out.
    left = carry_out(session, again)["measured"]
    assert [one["id"] for one in left] == [one["id"] for one in both if one["id"] != again.id]
    assert carry_out(session, Order("clear"))["measured"] == []
    added = carry_out(session, Order("room", shifts=shifts))["measured"]
    assert not {one["id"] for one in added} & {one["id"] for one in both}


def test_what_a_turned_section_hides_is_not_picked(shown, flat):
    shift, turn = np.array([0.0, 3.0, 0.0]), 0.6
    ray = ray_to(shown, flat[0])
    ray = ray._replace(origin=ray.origin + shift)
    place = flat[0] - shown.origin + shift
    around = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]) @ place
    for off, hit in ((0.0, 1), (1.0, 0)):
        box = np.stack([around - 0.3, around + 0.3]) + off
        session = Session([shown], None)
        carry_out(session, Order("pick", ray=ray, shifts=((0, shift),), section=box, turn_rad=turn))
        assert len(session.measured) == hit


def test_what_was_begun_ends_only_when_somebody_says_so(shown, flat):
    session = Session([shown, shown], None)
    shifts = ((0, np.zeros(3)), (1, np.zeros(3)))
    room, click = Order("room", shifts=shifts), Order("pick", ray=ray_to(shown, flat[0]), shifts=shifts)
    for other in (Order("cancel"), Order("undo"), Order("clear")):
        work = session.begin(room)
        assert isinstance(work, Work) and session.state()["measuring"] and session.finish(work._replace(id=-1)) is None
        assert session.begin(other)["message"] == "Ended: what went on was not measured."
        assert session.finish(work) is None and session.measured == []
    # Nor is the second cloud measured for nobody.
    assert work.measure(lambda: False) == ([], "")
    # Another kind and another click drop nothing.
    work = session.begin(room)
    carry_out(session, Order("choose", "flatness"))
    assert carry_out(session, click)["measuring"] == 1
    assert session.finish(work)["measuring"] == 0
    assert [entry.measured.kind for entry in session.measured] == ["flatness", *6 * ["room"]]
    # Not more than some go on at a time, and that is said.
    works = [session.begin(room) for _ in range(4)]
    assert session.begin(room)["message"].startswith("4 measurements go on")
    # Entries of the list may be saved and taken out meanwhile; to take back is to end what goes on.
    assert session.begin(Order("save", "csv"))["file"] == "measured.csv"
    assert session.begin(Order("remove", id=session.measured[0].id))["measuring"] == 4
    session.begin(Order("cancel"))
    assert all(session.finish(work) is None for work in works)
    assert session.begin(Order("cancel"))["message"] == "" and len(session.measured) == 6


def is_flat(shown, place):
    """Whether a plane is known there, as an angle needs it, and points enough within 20 mm."""
    try:
        found = measure_flatness(shown, place + shown.origin)
    except MeasurementError:
        return False
    away = np.linalg.norm(shown.xyz - place, axis=1)
    profiles = np.unique(shown.cells[away < 0.19] // shown.cloud.valid.shape[1])
    return found.value < 2e-3 and (away < 0.019).sum() >= 4 and len(profiles) >= 3


def walls_of(shown):
    """A place on each of two walls that meet, m, in the cloud's frame."""
    turned = np.array([[np.cos(shown.walls), np.sin(shown.walls)], [-np.sin(shown.walls), np.cos(shown.walls)]])
    along = shown.sides[:, :2] / 127.0 @ turned.T
    walls = (shown.xyz[along[:, axis] > 0.995] for axis in (0, 1))
    return [next(place for place in wall[::5] if is_flat(shown, place)) + shown.origin for wall in walls]


def test_an_angle_a_height_and_an_area(shown):
    session, shifts = Session([shown], None), ((0, np.zeros(3)),)
    click = lambda place: carry_out(session, Order("pick", ray=ray_to(shown, place), shifts=shifts))
    a, b = walls_of(shown)
    for kind in ("angle", "height"):
        carry_out(session, Order("choose", kind))
        assert len(click(a)["places"]) == 1
        state = click(b)
        assert state["places"] == [] and state["message"] == ""
    angle, height = (entry.measured for entry in session.measured)
    # The room is a box.
    assert abs(angle.value - 90) < 3 * angle.sigma < 3 and (angle.unit, angle.value_m) == ("deg", None)
    low, high = height.at[:, 2]
    assert height.value_m == pytest.approx(high - low, abs=0.02) and height.sigma_m > 0
    carry_out(session, Order("choose", "area"))
    assert "three corners" in carry_out(session, Order("close"))["message"]
    corners = [a, b, a + [0, 0, 0.4]]
    for corner in corners:
        state = click(corner)
    assert len(state["places"]) == 3
    # The first corner again closes it.
    assert click(a)["places"] == []
    area = session.measured[-1].measured
    p, q, r = area.at
    assert area.value == pytest.approx(0.5 * np.linalg.norm(np.cross(q - p, r - p)), rel=1e-6)
    (row,) = csv.DictReader(io.StringIO(as_csv([area]).decode()))
    assert (row["unit"], row["value_m"]) == ("m2", "") and float(row["value"]) == pytest.approx(area.value, abs=1e-5)


def test_the_volume_of_a_box_that_is_closed(shown):
    session, shifts = Session([shown], None), ((0, np.zeros(3)),)
    box = np.array([[-1.0, -1.0, -0.5], [1.0, 2.0, 0.5]])
    state = carry_out(session, Order("box", shifts=shifts, section=box, turn_rad=0.3))
    (found,) = session.measured
    c, s = np.cos(0.3), np.sin(0.3)
    inside = shown.xyz @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]).T
    count = np.count_nonzero(((inside >= box[0]) & (inside <= box[1])).all(1))
    assert found.measured.value == pytest.approx(6.0) and f"{count:,} points" in state["measured"][0]["words"][0]
    box[1, 2] = 1e6
    assert "is open" in carry_out(session, Order("box", shifts=shifts, section=box))["message"]


def test_a_page_that_clicks_beside_is_told(shown):
    session = Session([shown], None)
    away = Ray(np.array([0.0, 0.0, 500.0]), np.array([0.0, 0.0, 1.0]), 0.01)
    state = carry_out(session, Order("pick", ray=away, shifts=((0, np.zeros(3)),)))
    assert state["message"] == "There is no point: click on the cloud."
    assert "No cloud" in carry_out(session, Order("room"))["message"]


def test_nobody_knows_where_the_scanner_of_a_foreign_cloud_stood(shown):
    """Its origin is a place in it, or one of a map."""
    host = shown.cloud
    foreign = dataclasses.replace(host, angle=np.zeros_like(host.angle))
    assert len(ShownCloud("a", foreign, np.zeros(3)).stations()) == 1
    away = dataclasses.replace(foreign, xyz=np.asarray(host.xyz, np.float64) + [4e5, 5.4e6, 300.0])
    assert len(ShownCloud("a", away, np.array([4e5, 5.4e6, 300.0])).stations()) == 0
    np.testing.assert_array_equal(shown.stations(), [-shown.origin])


def test_points_without_a_sigma_are_grey(shown):
    host = shown.cloud
    half = np.asarray(host.sigma_random).copy()
    half[::2] = 0
    partly = dataclasses.replace(host, sigma_random=half, sigma_systematic=np.zeros_like(half))
    shown = ShownCloud("a", partly, np.zeros(3))
    colours, scale = shown.coloured("sigma", plane=None)
    unknown = shown.take(half) == 0
    assert unknown.any() and (colours[unknown] == 127).all() and (colours[~unknown] != 127).any(1).all()
    assert scale.low > 0


def test_a_cloud_on_a_map_beside_a_local_one(tiny, shown):
    """Each is shown about its own middle, so that nothing of either is rounded away."""
    host = shown.cloud
    far = np.array([4e5, 5.4e6, 300.0])
    xyz = np.where(np.asarray(host.valid)[..., None], np.asarray(host.xyz, np.float64) + far, 0.0)
    view = View([Named("here", host), Named("there", dataclasses.replace(host, xyz=xyz))])
    here, there = view.clouds
    np.testing.assert_allclose(there.origin - here.origin, far, atol=1)
    apart = np.sort((there.xyz + (there.origin - here.origin - far)).ravel()) - np.sort(here.xyz.ravel())
    assert np.abs(apart).max() < 1e-5
