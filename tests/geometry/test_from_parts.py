"""A scanner of one's own numbers, from public names alone."""

import numpy as np
import pytest

import jaxscan


CAMERA = jaxscan.Pinhole(300.0, 300.0, 159.5, 127.5, np.zeros(5), 320, 256)
SHEET = jaxscan.LaserSheet.from_plane([1.0, 0.0, 0.12], 0.25)
TABLE = jaxscan.Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.2])


def test_two_lines_give_the_points_of_the_paper():
    """Tables I and II of the paper and the design's table of signs; no distortion."""
    camera = jaxscan.Pinhole(2894.462, 2887.338, 1016.814, 817.261, np.zeros(5), 2048, 1638)
    axis = jaxscan.Turntable.from_axis([-0.018237, -0.999833, -0.000846], [-0.009786, 0.000358, -0.212275])
    scanner = jaxscan.Scanner.from_parts(camera, jaxscan.LaserSheet.from_abc(-7.606, -1.685, 1.296203), axis)
    for theta_deg, expected in ((0, [2.663958, -0.165195, 0.009750]), (30, [2.389653, 1.188916, 0.009750])):
        point, incidence = scanner.point(np.array([1200.0, 800.0]), 0, np.asarray(np.deg2rad(theta_deg)))
        assert incidence > 0
        # The axis is written with six digits, and the point is 2.7 m away from it.
        np.testing.assert_allclose(point, expected, atol=3e-6)


@pytest.mark.more
def test_a_perfect_sweep_is_reconstructed():
    scanner = jaxscan.Scanner.from_parts(CAMERA, SHEET, TABLE)
    # A stripe of Gaussian profile along column 200.5, at four angles of the table.
    columns = np.arange(320)
    stripe = 20 + 180 * np.exp(-0.5 * ((columns - 200.5) / 1.5) ** 2)
    on = np.broadcast_to(np.rint(stripe), (4, 256, 320)).astype(np.uint8)
    sweep = jaxscan.Sweep(on=on, off=np.full_like(on, 20), angles=np.deg2rad([0.0, 90.0, 180.0, 270.0]))
    cloud = jaxscan.reconstruct(sweep, scanner)
    line = 127
    expected = [scanner.point(np.array([200.5, line]), 0, np.asarray(phi))[0] for phi in sweep.angles]
    assert np.asarray(cloud.valid)[:, line].all()
    # A hundredth of a pixel on a sheet met at about 14 degrees, about 1 m away.
    np.testing.assert_allclose(np.asarray(cloud.xyz)[:, line], expected, atol=1e-4)


def test_an_axis_that_points_down_is_turned_with_its_angles():
    down = jaxscan.Turntable.from_axis([0.0, 2.0, 0.0], [0.0, 5.0, -0.2], gain=-1.0)
    found = [jaxscan.Scanner.from_parts(CAMERA, SHEET, table).turntable for table in (TABLE, down)]
    np.testing.assert_allclose(found[1].direction, found[0].direction, atol=1e-16)
    np.testing.assert_allclose(found[1].point, found[0].point, atol=1e-16)
    assert found[1].gain == found[0].gain == 1.0


def test_names_of_lasers():
    one, two = (jaxscan.Scanner.from_parts(CAMERA, sheets, TABLE) for sheets in (SHEET, [SHEET, SHEET]))
    assert (one.laser_names, two.laser_names) == (("laser",), ("laser1", "laser2"))
    named = jaxscan.Scanner.from_parts(CAMERA, [SHEET, SHEET], TABLE, laser_names=["red", "green"], up="+v")
    assert named.laser_names == ("red", "green") and named.turntable.direction[1] == 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jaxscan.Scanner.from_parts(CAMERA, [], TABLE), "lasers: expected one sheet"),
        (lambda: jaxscan.Scanner.from_parts(CAMERA, SHEET, TABLE, laser_names=["a", "b"]), "found a, b, expected 1"),
        (lambda: jaxscan.Scanner.from_parts(CAMERA, [SHEET] * 2, TABLE, laser_names=["a", "a"]), "2 different names"),
        (lambda: jaxscan.LaserSheet.from_plane([1.0, 0.0], 0.2), "normal of the plane: found"),
        (lambda: jaxscan.LaserSheet.from_abc(1.0, 2.0, 0.0), "distance: found 0 m"),
        (lambda: jaxscan.Turntable.from_axis([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), "direction: found"),
        (lambda: jaxscan.Turntable.from_axis([0.0, 1.0, 0.0], [0.0, np.inf, 1.0]), "point: found"),
        (lambda: jaxscan.Turntable.from_axis([0.0, 1.0, 0.0], [0.0, 0.0, 1.0], gain=0.0), "gain: found 0"),
    ],
)
def test_parts_that_are_none(make, message):
    with pytest.raises(ValueError, match=message):
        make()
