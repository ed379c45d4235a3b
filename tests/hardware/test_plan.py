"""Positions of the table, and the space and time of a capture."""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scanrig.config import RigConfig
from scanrig.session.plan import (
    angle_deg,
    estimate,
    longest_s,
    move_s,
    nearest,
    placement_positions,
    plan_sweep,
    shot_s,
)

from jaxscan.errors import ConfigError


def rig(**tables):
    camera = {"kind": "simulated", "width": 1280, "height": 1024, **tables.pop("camera", {})}
    return RigConfig.model_validate({"camera": camera, **tables})


def positions(**tables):
    return [target.position for target in plan_sweep(rig(**tables))[0]]


@settings(deadline=None)
@given(n=st.integers(8, 100_000), data=st.data())
def test_a_full_turn_stands_at_2kn_plus_k_over_2k(n, data):
    """The closed form of PROTOCOL.md, section 3, for every table and number of steps."""
    steps = data.draw(st.integers(1, min(n, 300)))
    found = positions(turntable={"full_steps": 4, "microsteps": 1, "gear": [n, 4]}, sweep={"steps": steps})
    assert found == [(2 * k * n + steps) // (2 * steps) for k in range(steps)]
    for k, position in enumerate(found):
        assert abs(Fraction(k * n, steps) - position) <= Fraction(1, 2)


def test_3600_steps_of_28800_are_exact_and_nothing_is_said():
    targets, notes = plan_sweep(rig(turntable={"gear": [9, 1]}))
    assert [target.position for target in targets] == [8 * k for k in range(3600)] and notes == ()
    assert [target.record for target in targets] == list(range(3600))


def test_steps_between_microsteps_are_said_and_do_not_add_up():
    targets, notes = plan_sweep(rig(turntable={"gear": [5, 1]}))
    (note,) = notes
    assert "4.4444 microsteps" in note and "0.0112 deg" in note
    worst = max(abs(angle_deg(target.position, 16000) - 0.1 * target.record) for target in targets)
    # Half a microstep of 16000 is 0.01125 deg; the worst of these steps is 4/9 of one away.
    assert worst == pytest.approx(0.010, abs=1e-4)


def test_more_steps_than_microsteps_are_refused():
    with pytest.raises(ConfigError, match=r"3600 steps in 360 deg, expected at most 3200: a turn has 3200 microsteps"):
        plan_sweep(rig())


def test_a_part_of_a_turn_from_anywhere_downwards():
    found = positions(turntable={"gear": [9, 1]}, sweep={"steps": 4, "turn_deg": -36.0, "start_deg": 90.0})
    assert found == [7200, 6480, 5760, 5040]


def test_a_tenth_of_a_degree_is_a_tenth():
    """0.1 as a float is more than a tenth; 3 of them would be rounded up."""
    assert nearest(0.3, 600) == nearest(Fraction(3, 10), 600) == 1
    assert nearest(-0.3, 600) == 0 and nearest(0.1 + 0.2, 600) == 1


def test_limits_hold_for_every_position_and_for_home():
    table = {"gear": [9, 1], "limits_deg": [-10.0, 200.0]}
    assert len(positions(turntable=table, sweep={"steps": 100, "turn_deg": 200.0})) == 100
    with pytest.raises(
        ConfigError, match=r"sweep: goes from 0 to 3\d\d\.\d+ deg, but turntable.limits_deg allows -10 to 200"
    ):
        plan_sweep(rig(turntable=table))
    with pytest.raises(ConfigError, match="calibration: goes from -15 to 15 deg"):
        placement_positions(rig(turntable=table))


def test_placements_are_distinct():
    assert placement_positions(rig(turntable={"gear": [9, 1]})) == 4 * ((-1200, -800, -400, 0, 400, 800, 1200),)
    with pytest.raises(ConfigError, match="found two at the same microstep"):
        placement_positions(rig(calibration={"angles_deg": [0.0, 0.05]}))


def test_placements_all_around():
    plan = {"placements": 3, "angles_deg": [-5.0, 5.0], "bearings_deg": [0.0, 180.0]}
    found = placement_positions(rig(turntable={"gear": [9, 1]}, calibration=plan))
    assert found == ((-400, 400), (14000, 14800), (-400, 400))
    limits = {"gear": [9, 1], "limits_deg": [-10.0, 100.0]}
    with pytest.raises(ConfigError, match="calibration: goes from -5 to 185 deg"):
        placement_positions(rig(turntable=limits, calibration=plan))


def test_a_capture_of_a_room_needs_what_it_needs():
    config = rig(turntable={"gear": [9, 1]})
    found = estimate(config, [target.position for target in plan_sweep(config)[0]])
    assert found.frames == 7200
    assert found.bytes == pytest.approx(7200 * 1280 * 1024 * 1.1, rel=1e-9)
    # A shot of 50 + 20 + 10 + 5 + 20 + 10 + 5 ms and the motion of 8 microsteps: 145 ms on the bench.
    assert found.seconds / 3600 == pytest.approx(0.145 + 0.03, abs=0.025)


def test_colour_takes_three_times_the_space():
    colour = rig(camera={"pixel_format": "rgb8"})
    assert estimate(colour, [0]).bytes == 3 * estimate(rig(), [0]).bytes


@settings(deadline=None)
@given(distance=st.integers(0, 100_000))
def test_motion_takes_as_long_as_its_ramps_and_its_run(distance):
    config = rig(turntable={"gear": [9, 1]})
    v0, v, a = 400.0, 4000.0, 8000.0
    # The ramp by small steps: speed grows by a ds / v.
    expected, speed = 0.0, v0
    ramp = min(distance / 2, (v * v - v0 * v0) / (2 * a))
    steps = 2000
    for _ in range(steps):
        ds = ramp / steps
        faster = (speed * speed + 2 * a * ds) ** 0.5
        expected += 2 * ds / ((speed + faster) / 2)
        speed = faster
    expected += (distance - 2 * ramp) / v
    assert move_s(config, distance) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert longest_s(config) > 2 * move_s(config, distance)


def test_waits_for_a_camera_that_is_not_ready_are_allowed_for():
    assert shot_s(rig(trigger={"ready_ms": 500})) - shot_s(rig()) == pytest.approx(1.0)
