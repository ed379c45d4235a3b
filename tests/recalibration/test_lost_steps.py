"""Lost steps in an ideal room: found, named and repaired; a good table is left alone."""

import numpy as np
import pytest

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable
from jaxscan.recalibration.lost_steps import Equations, LostStep, check_angles, fit_steps, lasting, say_jump
from tests.recalibration.faces import box, pose, solid, take


pytestmark = pytest.mark.more

ROOM = box(-1.85, 1.97, -3.0, 3.15, -1.2, 1.3)
FURNITURE = [
    *solid((-1.7, 0.7, -1.2), (-1.1, 1.7, 0.0)),
    *solid((1.375, -2.2, -1.2), (1.825, -1.4, 0.8)),
    *solid((-0.3, 2.725, -1.2), (0.9, 3.075, -0.2)),
]
KNOCKED = {"fx": 8.0, "fy": 8.0, "cx": 8.0, "cy": 8.0, "k1": 0.01, "k2": 0.02, "gain": 3e-4} | {
    "n1": 1e-3, "n2": 1e-3, "d": 5e-4, "d1": 1e-3, "d2": 1e-3, "p1": 1e-3, "p2": 1e-3
}  # fmt: skip
"""By how much a poor calibration errs [px, rad, m]."""


def paper_scanner():
    """The scanner of the paper without distortion; its image has 40 lines, over the same field of view."""
    tall = 40 / 1638
    lens = {"fx": 2894.462, "fy": tall * 2887.338, "cx": 1016.814, "cy": tall * 817.261, "distortion": np.zeros(5)}
    sheet = LaserSheet.from_plane(np.array([-7.606, -1.685, 1.0]), 1.296203)
    table = Turntable.from_axis([-0.018237, -0.999833, -0.000846], [-0.009786, 0.000358, -0.212275])
    return Scanner.from_parts(Pinhole(**lens, width=2048, height=40), sheet, table)


def sweep(phi, faces, true=None, seed=0):
    """A sweep with so many evenly spaced angles [rad] and noise of 0.1 px."""
    turn = len(phi) * float(phi[1] - phi[0])
    how = {"steps": len(phi), "turn": turn, "noise_px": 0.1, "seed": seed, "pose": pose((0.0, 0.0, 0.0), 17.2)}
    return take(faces, paper_scanner(), stood=true, **how).sweep


def checked(phi, true, seed):
    """The findings with a poor calibration, and the corrected angles less the true ones."""
    scanner, rng = paper_scanner(), np.random.default_rng(seed)
    sigma = np.array([KNOCKED.get(name.split(".")[-1], 0.0) for name in scanner.parameter_names()])
    poor = scanner.retract(0.3 * sigma * rng.standard_normal(len(sigma)))
    found = check_angles([sweep(phi, [*ROOM, *FURNITURE], true, seed)], poor)
    return found, phi + found.corrections[0] - true


def poor_table(theta):
    """Errors once and twice per turn of 0.5 mrad, and of the gain of 3e-4, that are no faults."""
    return theta * (1 + 3e-4) + 5e-4 * np.sin(theta + 1.0) + 5e-4 * np.sin(2 * theta + 2.0)


@pytest.mark.parametrize(("turn_deg", "seed"), [(390.0, 2), (140.0, 3)])
def test_a_good_table_is_left_alone(turn_deg, seed):
    phi = np.linspace(0.0, np.deg2rad(turn_deg), 240, endpoint=False)
    found, _ = checked(phi, poor_table(phi), seed)
    assert found.sentences == () and found.jumps == ()
    assert not np.any(found.corrections[0])


@pytest.mark.parametrize(("degrees", "record"), [(0.2, 130), (1.8, 170)])
def test_a_lost_step_is_found_and_repaired(degrees, record):
    phi = np.linspace(0.0, 2 * np.pi, 240, endpoint=False)
    true = poor_table(phi)
    true[record:] -= np.deg2rad(degrees)
    found, error = checked(phi, true, 6)
    ((number, at, size),) = found.jumps
    assert number == 0 and abs(at - record) <= 1
    # 0.1 px on 40 lines: the size is known to some hundredths of a degree.
    assert np.rad2deg(size) == pytest.approx(-degrees, abs=0.05)
    assert f"{record - 1} and {record}" in found.sentences[0] and "behind" in found.sentences[0]
    away = np.ones(240, bool)
    away[record - 2 : record + 2] = False
    assert np.abs(error[away]).max() < np.deg2rad(0.05) + 3e-4 * 2 * np.pi + 1e-3


@pytest.mark.parametrize("steps", [((100, 0.3), (240, 0.5)), ((90, 1.8), (285, 1.8))], ids=["small", "large"])
def test_two_lost_steps_are_told_apart(steps):
    """Small ones stand out of the errors; of two large ones the second is found by the break of its wall alone."""
    phi = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    true = phi.copy()
    for record, degrees in steps:
        true[record:] -= np.deg2rad(degrees)
    found, _ = checked(phi, true, 7)
    assert [record for _, record, _ in found.jumps] == pytest.approx([record for record, _ in steps], abs=1)
    assert len(found.sentences) == 2


def test_steps_that_undo_each_other_are_a_wall_that_stands_out():
    """Of a pair, and of three; a step that lasts stays beside them."""
    ahead, more, back = (LostStep(k, k, k, size, 3e-4) for k, size in ((87, 3e-3), (91, 5e-3), (113, -8e-3)))
    last = LostStep(200, 200, 200, 3e-3, 3e-4)
    assert lasting([back, ahead, more]) == []
    assert lasting([ahead, more, back, last]) == [last]
    assert lasting([last, ahead]) == [ahead, last]


def test_nothing_is_said_without_walls_or_of_a_tiny_sweep():
    tiny, cloud = sweep(np.linspace(0.0, 0.05, 6), ROOM), sweep(np.linspace(0.0, 6.0, 240), ROOM)
    noise = np.random.default_rng(8).uniform(950, 1400, cloud.centre.shape)
    cloud = cloud._replace(centre=noise.astype(np.float32))
    empty = cloud._replace(valid=np.zeros_like(cloud.valid))
    found = check_angles([tiny, cloud, empty], paper_scanner())
    assert found.sentences == () and found.jumps == ()
    assert [len(one) for one in found.corrections] == [6, 240, 240]


def test_steps_of_all_records_equal_separate_fits():
    rng = np.random.default_rng(9)
    records, rows = 12, 90
    record = np.sort(rng.integers(0, records, rows))
    turn, nuisance, error = rng.standard_normal(rows), rng.standard_normal((rows, 4)), rng.standard_normal(rows)
    test = fit_steps(Equations(error, turn, nuisance, record, np.zeros(4), np.full(4, 1e6)), records)
    for k in range(1, records):
        column = np.where(record >= k, turn, 0.0)
        both = np.column_stack([nuisance, column])
        expected = np.linalg.lstsq(both, error)[0][-1]
        sigma = np.sqrt(np.linalg.inv(both.T @ both)[-1, -1])
        # Both solve the same equations; a prior of 1e6 changes them by 1e-12.
        assert test.size[k] == pytest.approx(expected, rel=1e-8)
        assert test.sigma[k] == pytest.approx(sigma, rel=1e-8)


def test_sentences_name_the_likely_cause():
    assert "200 steps per turn behind a gear of 16" in say_jump("a", (1799, 1800), -0.113, 0.004)
    assert "ahead" in say_jump("a", (1, 2), 0.5, 0.01) and "full step" not in say_jump("a", (1, 2), 0.5, 0.01)
