"""Light that comes back: from walls, against integrals; from a mirror, where its picture is."""

import numpy as np
import pytest

from jaxscan.simulation import LightSpec, MirrorSpec, RoomSpec, SimulationConfig, expect_record, make_rig, make_scene
from jaxscan.simulation.light import LitScene, line_pieces, returned_field
from jaxscan.simulation.light.bounce import Pieces
from jaxscan.simulation.scene import Material
from tests.simulation import plain
from tests.simulation.plain import CX, GREY, WIDTH, F


HEIGHT, CY, CROSSING = 120, 60.3, 2.0
GLASS = Material(((0.0, 0.0, 0.0),), mirror=0.9)


def rig_of(bounce=0.0, fan=16.0, **laser):
    light = LightSpec(shadows=False, bounce=bounce)
    return make_rig(plain.config(HEIGHT, {"waist_mm": 3.0, "fan_deg": fan, **laser}, light=light))


def scanner(*camera):
    """Scanner coordinates of camera ones: camera z = scanner x, camera x = -y, camera y = -z."""
    x, y, z = camera
    return np.array([z, -x, -y], float)


def scene_of(*quads):
    def add(mesh, corner, one, other, material=GREY):
        mesh.quad(scanner(*corner), scanner(*one), scanner(*other), material)

    return plain.scene_of(*(lambda mesh, parts=parts: add(mesh, *parts) for parts in quads))


WALL = (-9, -9, 2), (18, 0, 0), (0, 18, 0)
"""Faces the camera at 2 m."""


def test_pieces_give_back_as_much_as_the_camera_sees_of_the_line():
    rig, scene = rig_of(), scene_of(WALL)
    pieces = line_pieces(LitScene(rig, rig.sheets[0], scene, rig.pose(0.0), None))
    # The whole line is in the image: light times the area of the wall that a pixel sees.
    seen = expect_record(rig, scene, 0.0).laser.astype(float).sum() * (2.0 / F) ** 2
    # The ends of the fan are soft over two degrees, which few pieces share.
    assert pieces.power.sum() == pytest.approx(seen, rel=0.01)
    np.testing.assert_allclose(pieces.points[:, 0], 2.0, atol=0.003)
    np.testing.assert_allclose(pieces.points[:, 1], 0.0, atol=0.003)


def test_one_piece_lights_a_point_by_the_cosines_and_the_square_of_the_distance():
    rig = rig_of()
    scene = scene_of(WALL)
    shot = LitScene(rig, rig.sheets[0], scene, rig.pose(0.0), None)
    lamp = Pieces(np.array([[1.0, 0.5, 0.0]], np.float32), np.array([[1.0, 0, 0]], np.float32), np.ones(1, np.float32))
    point = np.array([1.9, -0.4, 0.3], np.float32)
    field = returned_field(shot, lamp, np.broadcast_to(point, (HEIGHT, WIDTH, 3)).__getitem__)
    leg = lamp.points[0] - point
    d = np.linalg.norm(leg)
    expected = leg / d * (0.9 / d) / (np.pi * d**2)
    # A piece of 3 cm is no point: 1e-3 of the light at this distance.
    np.testing.assert_allclose(field[:, 40, 70], expected, rtol=3e-3)
    np.testing.assert_allclose(field[:, 0, 0], field[:, -1, -1], rtol=1e-6)


SIDE = (-0.3, -9, 0.5), (0, 0, 4), (0, 18, 0)
"""A wall along the view, to the left of it."""


def test_a_side_wall_is_lit_as_an_integral_over_the_line_says():
    plain, lit = (expect_record(rig_of(bounce), scene_of(WALL, SIDE), 0.0) for bounce in (0.0, 1.0))
    returned = (lit.laser - plain.laser).astype(float)
    sheet = rig_of().sheets[0]
    # Points of the line, from the laser at (0.3, 0, 0), each with its share of the fan's power.
    angle = np.linspace(-8, 8, 2001)[:-1] + 0.004
    soft = np.clip((8 - np.abs(angle)) / 2, 0, 1)
    power = 0.7 * sheet.power * np.deg2rad(16 / 2000) * soft
    line = np.stack([0 * angle, -np.hypot(2, 0.3) * np.tan(np.deg2rad(angle)), 0 * angle + 2], -1)
    for u, v in ((4, 60), (12, 20), (17, 100)):
        x, y = (u - CX) / F, (v - CY) / F
        point = np.array([x, y, 1]) * (-0.3 / x)
        leg = line - point
        d = np.linalg.norm(leg, axis=1)
        expected = 0.7 * np.sum(power * (leg[:, 2] / d) * (leg[:, 0] / d) / (np.pi * d**2))
        # Pieces of a third of a degree, a grid of eight pixels and the lens's blur: some per cent.
        assert returned[v, u] == pytest.approx(expected, rel=0.06), (u, v)
    # A flat wall does not light itself.
    assert np.abs(returned[:, 100:]).max() < 1e-5
    np.testing.assert_array_equal(plain.truth.amplitude, lit.truth.amplitude)


def test_what_is_hidden_from_the_line_gets_nothing():
    screen = (-0.2, -9, 1.0), (0, 0, 0.98), (0, 18, 0)
    open_, hidden = (
        expect_record(rig_of(1.0), scene_of(WALL, SIDE, *extra), 0.0).laser
        - expect_record(rig_of(0.0), scene_of(WALL, SIDE, *extra), 0.0).laser
        for extra in ((), (screen,))
    )
    # Column 5 shows the side wall at 1.2 m; the screen stands between it and the line.
    assert open_[20:100, 5].min() > 0.05
    assert hidden[20:100, 5].max() < 0.1 * open_[20:100, 5].min()


def test_a_mirror_shows_the_stripe_where_its_picture_is():
    mirror = (0.2, -9, 0.85), (0, 0, 0.3), (0, 18, 0), GLASS
    rig = rig_of(fan=40.0, speckle_contrast=0.3)
    plain, mirrored = (expect_record(rig, scene_of(*quads), 0.0) for quads in ((WALL,), (WALL, mirror)))
    part = slice(122, 158)
    row = mirrored.laser[60].astype(float)
    # The stripe at x = 0, z = 2 has its picture at x = 0.4.
    u = np.arange(WIDTH)[part]
    assert (row[part] * u).sum() / row[part].sum() == pytest.approx(CX + F * 0.4 / 2, abs=0.02)
    assert row[part].sum() == pytest.approx(0.9 * plain.laser[60].sum(), rel=0.01)
    assert len(mirrored.samples) == 2
    # The truth is the stripe itself.
    np.testing.assert_allclose(mirrored.truth.u[20:100], plain.truth.u[20:100], atol=1e-6)
    np.testing.assert_allclose(mirrored.truth.amplitude[20:100], plain.truth.amplitude[20:100], rtol=1e-6)


def test_a_mirror_shows_the_room_and_has_no_stripe_of_its_own():
    facing = (-0.5, -9, 1.5), (1.0, 0, 0), (0, 18, 0), GLASS
    behind = (-9, -9, -1.0), (18, 0, 0), (0, 18, 0), Material(((0.5, 0.5, 0.5),))
    record = expect_record(rig_of(), scene_of(WALL, facing, behind), 0.0)
    # The sheet crosses the mirror everywhere, and surfaces behind the camera are not lit by it.
    assert not record.truth.valid.any()
    assert record.laser.max() == 0
    # White in the room's mean light is 120 DN.
    assert 0.9 * 0.5 * 120 * 0.5 < record.off[60, 80] < 0.9 * 0.5 * 120 * 2


@pytest.mark.parametrize("wall", ["x0", "x1", "y0", "y1"])
def test_a_room_s_mirror_hangs_on_its_wall(wall):
    room = RoomSpec(mirror=MirrorSpec(wall=wall, along_m=1.2, height_m=1.5, size_m=(0.4, 0.6)))
    scene = make_scene(SimulationConfig(room=room))
    inward = {"x0": (0.2, 1.2), "x1": (4.0, 1.2), "y0": (1.2, 0.2), "y1": (1.2, 5.2)}[wall]
    assert scene.mirror.max() == pytest.approx(0.9)
    # Seen from 20 cm before it, room coordinates to the scanner's.
    yaw = np.deg2rad(room.yaw_deg)
    turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    eye = turn @ (np.array([*inward, 1.5]) - np.array(room.rig_m))
    way = turn @ {"x0": (-1, 0, 0), "x1": (1, 0, 0), "y0": (0, -1, 0), "y1": (0, 1, 0)}[wall]
    far, triangle = scene.cast(eye, way[None])
    assert far[0] == pytest.approx(0.17, abs=1e-4) and scene.mirror[triangle[0]] > 0


def test_a_mirror_throws_the_laser_s_light_on_other_surfaces():
    side, mirror = ((-0.15, -9, 0.5), (0, 0, 4), (0, 18, 0)), ((-0.14, -0.3, 2.0), (0.6, 0, 0), (0, 0.6, 0), GLASS)
    rig = rig_of(fan=60.0)
    record = expect_record(rig, scene_of(side, mirror), 0.0)
    row = record.laser[60, :60].astype(float)
    # From (0.3, 0, 0) by way of (0, 0, 2) to the side wall at z = 1: as from the laser's picture at (0.3, 0, 4).
    assert (row * np.arange(60)).sum() / row.sum() == pytest.approx(CX - 0.15 * F / 1.0, abs=0.05)
    leg = np.array([0.45, 0.0, 3.0])
    r, across = np.linalg.norm(leg), (1 / CROSSING) / np.hypot(1 / 0.3, 1 / CROSSING)
    expected = 0.9 * 0.7 * rig.sheets[0].power * (leg[0] / r) / r * (0.15 * F / 1.0**2) / across
    # The stripe is so wide on the grazed wall that its distance changes within it.
    assert row.sum() == pytest.approx(expected, rel=0.04)
    # It is no truth: the sheet itself passes the side wall where the camera does not see it.
    assert not record.truth.valid[60]


def test_the_height_of_the_mirror_bounds_what_it_throws():
    side, mirror = ((-0.15, -9, 0.5), (0, 0, 4), (0, 18, 0)), ((-0.14, -0.06, 2.0), (0.6, 0, 0), (0, 0.06, 0), GLASS)
    record = expect_record(rig_of(fan=60.0), scene_of(side, mirror), 0.0)
    lit = np.flatnonzero(record.laser[:, 20:50].max(1) > 0.3 * record.laser[:, 20:50].max())
    # Seen from the laser's picture, 2 m behind the mirror and 3 m from the wall, which the camera sees at 1 m.
    assert lit[-1] == pytest.approx(CY, abs=2) and lit[0] == pytest.approx(CY - 0.06 * 3 / 2 * F, abs=2)
