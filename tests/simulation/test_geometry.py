"""The simulator's own geometry against the house's: two derivations, one answer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import ConfigError
from jaxscan.simulation import (
    CameraSpec,
    LaserSpec,
    RoomSpec,
    SimulationConfig,
    TurntableSpec,
    make_rig,
    true_scanner,
    truth,
)
from jaxscan.simulation.rig import distort, ray_table, undistort
from jaxscan.simulation.scene import room_from_scanner


CAMERA = CameraSpec(width=96, height=80, fx=70, fy=72, cx=47.3, cy=40.1, k1=-0.2, k2=0.05, p1=1e-3, p2=-2e-3, k3=-0.004)
LASERS = {
    "baseline": LaserSpec(baseline_m=0.4, crossing_m=3.0, bow=(0.003, -0.002)),
    "paper": LaserSpec(a=-7.606, b=-1.685, c_mm=1296.203),
    "normal": LaserSpec(normal=(-2.0, 0.4, -1.0), distance_m=-0.5),
    "columns": LaserSpec(normal=(0.1, 2.0, 0.6), distance_m=0.3, stripe_axis="columns"),
}
TABLES = {
    "axis": TurntableSpec(direction=(0.1, -2.0, 0.05), point_m=(0.2, 0.7, -0.05), harmonics=(1e-3, -2e-3, 3e-3, 5e-4)),
    "downward": TurntableSpec(direction=(0.1, 2.0, 0.05), point_m=(0.2, 0.7, -0.05), gain=-1.001),
    "object": TurntableSpec(direction=(0.0, -1.0, -0.2), point_m=(0.0, 0.1, 0.4), carries="object", gain=0.999),
    "tr": TurntableSpec(
        tr=(
            (0.9994, 4.0e-05, -0.0345, -7.3403),
            (-1.845e-05, 0.9999997, 0.00063, 3.1e-06),
            (0.03458, -0.00063, 0.99940, 0.21142),
            (0.0, 0.0, 0.0, 1.0),
        )
    ),
}


def config(**changes) -> SimulationConfig:
    return SimulationConfig(**{"camera": CAMERA, "room": RoomSpec(), **changes})


def test_rays_agree_with_the_house():
    scanner = true_scanner(config())
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    q = np.stack([u, v], -1).reshape(-1, 2)
    unit = np.asarray(jax.vmap(scanner.camera.unproject)(jnp.asarray(q)))
    x, y = undistort(CAMERA, u, v)
    # Both iterations stop at 1e-12 of the normalised coordinates.
    np.testing.assert_allclose(np.stack([x, y], -1).reshape(-1, 2), unit[:, :2] / unit[:, 2:], atol=1e-11)
    table = ray_table(CAMERA)
    np.testing.assert_allclose(np.stack(distort(CAMERA, x, y), -1).reshape(-1, 2), q, atol=1e-9)
    # Within a pixel the table is linear. The error falls with the focal length and
    # the distortion: 3e-3 px for this lens of 70 px, 1e-4 px for those in use.
    du, dv = 0.375, -0.25
    moved = np.stack([table.x + table.x_u * du + table.x_v * dv, table.y + table.y_u * du + table.y_v * dv], -1)
    exact = np.stack(undistort(CAMERA, u + du, v + dv), -1)
    assert np.abs(moved - exact).max() * CAMERA.fx < 3e-3


def test_a_lens_that_folds_over_is_refused():
    with pytest.raises(ConfigError, match="cannot be inverted"):
        ray_table(CAMERA.model_copy(update={"k1": -1.5}))


@pytest.mark.parametrize("table", TABLES)
def test_poses_agree_with_the_house(table):
    c = config(turntable=TABLES[table])
    rig, scanner = make_rig(c), true_scanner(c)
    for phi in (-3.0, 0.0, 0.1, 2.5, 7.0):
        theirs = np.asarray(scanner.pose(jnp.asarray(phi)))
        ours = rig.pose(phi)
        # Metres and radians of order 1 in float64.
        np.testing.assert_allclose(ours.rotation, theirs[:3, :3], atol=1e-12)
        np.testing.assert_allclose(ours.translation, theirs[:3, 3], atol=1e-12)


@pytest.mark.parametrize("laser", LASERS)
def test_sheets_agree_with_the_house(laser):
    c = config(laser=LASERS[laser])
    sheet, theirs = make_rig(c).sheets[0], true_scanner(c).laser(0)
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform(-0.5, 0.5, 200), rng.uniform(-0.5, 0.5, 200), rng.uniform(0.3, 5, 200)
    points = np.stack([x * z, y * z, z], -1)
    np.testing.assert_allclose(
        z * sheet.slope_at(x, y) - sheet.distance, jax.vmap(theirs.offset)(jnp.asarray(points)), atol=1e-12
    )
    # The fan starts in the sheet (in its flat part) and its middle looks along the sheet.
    assert abs(sheet.normal @ sheet.origin - sheet.distance) < 1e-12
    assert abs(sheet.ahead @ sheet.normal) < 1e-12 and sheet.ahead[2] > 0


def test_truth_holds_what_is_rendered():
    c = config(laser=LASERS["paper"], turntable=TABLES["tr"])
    values = truth(c)
    assert values["format"] == "jaxscan-truth/1"
    assert set(values["parameters"]) == set(true_scanner(c).parameter_names())
    # DESIGN's table of signs.
    np.testing.assert_allclose(values["turntable"]["direction"], (-0.018237, -0.999833, -0.000846), atol=1e-6)
    np.testing.assert_allclose(values["turntable"]["point_m"], (-0.009786, 0.000358, -0.212275), atol=1e-6)
    motion = room_from_scanner(c)
    inside = motion.inverse().apply(np.array([[0.1, 0.2, 0.3]]))
    planes = {p["name"]: inside[0] @ p["normal"] - p["distance_m"] for p in values["room"]["planes"]}
    size = c.room.size_m
    expected = dict.fromkeys(planes, 0.0) | {"wall x0": 0.1, "wall y0": 0.2, "floor": 0.3}
    expected |= {"wall x1": size[0] - 0.1, "wall y1": size[1] - 0.2, "ceiling": size[2] - 0.3}
    assert planes == pytest.approx(expected, abs=1e-12)
    for length in values["room"]["distances"]:
        assert np.linalg.norm(np.subtract(length["to_m"], length["from_m"])) == pytest.approx(length["distance_m"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"laser": {"a": 1.0, "b": 2.0}}, "exactly one of"),
        ({"laser": {"baseline_m": 0.4, "crossing_m": 3.0, "distance_m": 1.0}}, "exactly one of"),
        ({"turntable": {"direction": (0, 1, 0)}}, "direction"),
        ({"object": {}}, "either"),
        ({"room": {"rig_m": (9.0, 1.0, 1.0)}}, "inside the room"),
        ({"boards": {"range_m": (2.0, 1.0)}}, "smallest"),
        ({"sensor": {"psf": 0.7}}, "Extra inputs"),
    ],
)
def test_bad_configurations_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        SimulationConfig(**{"room": {}, **changes})


def test_a_rig_that_cannot_work_is_refused():
    with pytest.raises(ConfigError, match="beside its sheet"):
        make_rig(config(laser=LaserSpec(baseline_m=0.4, crossing_m=3.0, origin_m=(0.2, 0.0, 0.0))))
    with pytest.raises(ConfigError, match="no triangulation"):
        make_rig(config(laser=LaserSpec(normal=(0.0, 0.0, 1.0), distance_m=1.0)))
    with pytest.raises(ConfigError, match="along the turntable's axis"):
        make_rig(config(turntable=TurntableSpec(direction=(0, 0, 1), point_m=(0, 0, 0))))
