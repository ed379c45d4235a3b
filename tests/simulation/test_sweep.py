"""Whole records: order, seeds, formats, the room that is seen."""

import numpy as np
import pytest

from jaxscan.simulation import (
    BoardsSpec,
    CameraSpec,
    LaserSpec,
    ObjectSpec,
    PlanSpec,
    RoomSpec,
    SensorSpec,
    SimulationConfig,
    TurntableSpec,
    expect_sweep,
    make_rig,
    make_scene,
    render_boards,
    render_sweep,
    sweep_angles,
    true_cloud,
    truth,
)
from jaxscan.simulation.scene import room_from_scanner


CONFIG = SimulationConfig(
    camera=CameraSpec(width=96, height=80, fx=62, fy=62, k1=-0.05),
    laser=LaserSpec(baseline_m=0.4, crossing_m=3.0, waist_mm=2.0, fan_deg=120.0),
    turntable=TurntableSpec(direction=(0.01, -1.0, 0.01), point_m=(0.1, 0.0, -0.05), gain=-1.0),
    room=RoomSpec(),
    boards=BoardsSpec(
        type="chessboard", columns=7, rows=5, square_mm=40, free_views=2, placements=1, angles=2, range_m=(0.5, 1.0)
    ),
    plan=PlanSpec(steps=24),
    seed=7,
)


def test_a_sweep_repeats_with_its_seed_and_differs_with_another():
    first, again, other = (list(render_sweep(CONFIG, every=8, seed=seed)) for seed in (None, 7, 8))
    assert [record.angle for record in first] == pytest.approx(list(np.radians([0, 120, 240])))
    assert all(record.placement is None for record in first)
    for a, b, c in zip(first, again, other, strict=True):
        assert a.on.dtype == np.uint8 and a.on.shape == a.off.shape == (80, 96)
        np.testing.assert_array_equal(a.on, b.on)
        np.testing.assert_array_equal(a.off, b.off)
        assert (a.on != c.on).mean() > 0.3 and (a.off != a.on).mean() > 0.3
        # The scene is the same, only the noise is not.
        np.testing.assert_array_equal(a.truth.u, c.truth.u)
    # A coarser sweep is part of the finer one.
    np.testing.assert_array_equal(first[1].on, list(render_sweep(CONFIG, every=4))[2].on)
    with pytest.raises(ValueError, match="every"):
        sweep_angles(CONFIG, every=0)


def test_frames_scatter_about_their_expectation():
    expected, rendered = (
        next(iter(source)) for source in (expect_sweep(CONFIG, every=24), render_sweep(CONFIG, every=24))
    )
    sensor = CONFIG.sensor
    for frame, mean in ((rendered.off, expected.off), (rendered.on, expected.off + expected.laser)):
        inside = (mean > 10) & (mean < 240)
        z = (frame[inside] - mean[inside]) / np.sqrt(
            sensor.read_dn**2 + mean[inside] / sensor.electrons_per_dn + 1 / 12
        )
        # Some thousands of pixels: five standard errors.
        assert abs(z.mean()) < 5 / np.sqrt(inside.sum())
        assert z.std() == pytest.approx(1, abs=5 / np.sqrt(2 * inside.sum()))


def test_the_true_cloud_lies_on_the_walls_of_an_empty_room():
    config = CONFIG.model_copy(update={"room": RoomSpec(furniture=False)})
    xyz, valid, angle = true_cloud(expect_sweep(config, every=2))
    assert xyz.shape == (12, 80, 3) and valid.shape == (12, 80) and len(angle) == 12
    assert valid.mean() > 0.9
    planes = truth(config)["room"]["planes"]
    distance = np.stack([xyz[valid] @ p["normal"] - p["distance_m"] for p in planes], -1)
    # float32 casting in a room of metres.
    assert np.abs(distance).min(-1).max() < 5e-6
    assert distance.min() > -5e-6
    # All six are seen: the walls all round, floor and ceiling above and below.
    assert (np.bincount(np.abs(distance).argmin(-1), minlength=6) > 10).all()
    assert (xyz[~valid] == 0).all()


def test_furniture_leaves_two_fifths_of_every_wall():
    config = CONFIG.model_copy(
        update={
            "camera": CameraSpec(width=96, height=80, fx=30, fy=30),
            "laser": (LaserSpec(baseline_m=0.4, crossing_m=3.0),),
        }
    )
    rig, scene = make_rig(config), make_scene(config)
    walls = {p["name"]: p for p in truth(config)["room"]["planes"] if p["name"].startswith("wall")}
    x, y, z = config.room.size_m
    rng = np.random.default_rng(0)
    motion = room_from_scanner(config).inverse()
    for name in walls:
        points = rng.uniform(0, 1, (4000, 3)) * (x, y, z)
        points[:, "xy".index(name[5])] = {"0": 0.0, "1": (x, y)["xy".index(name[5])]}[name[6]]
        seen = ~scene.blocked(np.zeros(3), motion.apply(points).astype(np.float32), skin=2e-3)
        assert seen.mean() > 0.4, name
    assert rig.pose(0.0).translation @ rig.pose(0.0).translation < 1


def test_colour_and_mosaic_see_the_same_world():
    frames = {}
    for pixel_format in ("mono8", "rgb8", "bayer_rggb8"):
        sensor = SensorSpec(pixel_format=pixel_format, crosstalk=0.1)
        frames[pixel_format] = next(iter(expect_sweep(CONFIG.model_copy(update={"sensor": sensor}), every=24)))
    rgb, bayer, mono = frames["rgb8"], frames["bayer_rggb8"], frames["mono8"]
    np.testing.assert_array_equal(bayer.off[::2, ::2], rgb.off[::2, ::2, 0])
    np.testing.assert_array_equal(bayer.laser[1::2, ::2], rgb.laser[1::2, ::2, 1])
    np.testing.assert_allclose(rgb.laser[..., 0], mono.laser, rtol=1e-6)
    np.testing.assert_allclose(rgb.laser[..., 2], 0.1 * mono.laser, rtol=1e-5)
    np.testing.assert_allclose(rgb.off @ np.array([0.3, 0.59, 0.11], np.float32), mono.off, atol=0.02)
    # It is a coloured room.
    assert np.ptp(rgb.off, axis=-1).max() > 30


def test_boards_come_in_the_order_of_the_protocol():
    picture = np.kron(np.indices((6, 8)).sum(0) % 2 * 255, np.ones((40, 40))).astype(np.uint8)
    first, again = (list(render_boards(CONFIG, picture)) for _ in range(2))
    assert [record.placement for record in first] == [None, None, 0, 0]
    assert first[0].angle == first[1].angle == 0 and first[2].angle < first[3].angle
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.on, b.on)
    # White print and black print are both there.
    assert np.ptp(first[0].off) > 60


def test_several_lasers_take_turns():
    lasers = (
        LaserSpec(name="left", baseline_m=0.4, crossing_m=3.0),
        LaserSpec(name="right", baseline_m=-0.4, crossing_m=3.0, colour="green"),
    )
    records = list(render_sweep(CONFIG.model_copy(update={"laser": lasers}), every=12))
    assert [record.laser_index for record in records] == [0, 1, 0, 1]
    assert records[0].angle == records[1].angle
    assert (records[0].truth.u != records[1].truth.u).any()
    # Two exposures, two draws of noise.
    assert (records[0].off != records[1].off).mean() > 0.3


def test_an_object_turns_before_a_camera_that_stands_still():
    config = SimulationConfig(
        camera=CameraSpec(width=96, height=80, fx=100, fy=100),
        laser=LaserSpec(baseline_m=0.14, crossing_m=0.35, waist_mm=0.3, focus_m=0.35, range_m=0.35),
        turntable=TurntableSpec(direction=(0.0, -1.0, -0.2), point_m=(0.0, 0.0, 0.35), carries="object"),
        object=ObjectSpec(base_z_m=-0.12),
        plan=PlanSpec(steps=4),
    )
    records = list(expect_sweep(config))
    xyz, valid, _ = true_cloud(records)
    assert valid.any(1).all()
    # Everything lit stands on the plate, within its radius; the vase itself is a body of revolution.
    radius = np.hypot(*xyz[valid][:, :2].T)
    assert radius.max() < config.object.plate_radius_m + 1e-5
    assert xyz[valid][:, 2].max() < -0.12 + config.object.height_m + 1e-5
    # Where nothing is seen, it is dark.
    assert (records[0].off == 0).any()
    assert "room" not in truth(config)
