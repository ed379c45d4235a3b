"""Aiming: pairs at home, again and again, with the laser off at the end however it ends."""

import pytest
from scanrig.errors import Fault, LinkLost
from scanrig.session import Hooks, run_aiming

from .desk import Desk


def aim(desk, looks, **hooks):
    """What `run_aiming` returns after so many looks, and the looks."""
    seen = []
    returned = run_aiming(
        desk.config, desk.devices, seen.append, Hooks(should_stop=lambda: len(seen) >= looks, **hooks)
    )
    return returned, seen


def dark(desk):
    return not desk.table.laser and not desk.table.contactor


def test_pairs_at_home_and_dark_in_the_end():
    desk = Desk()
    said, seen = aim(desk, 3)
    assert said == "" and dark(desk) and desk.controller.shots == [0, 0, 0]
    assert all(sight.proof.ok and sight.on.shape == sight.off.shape == (96, 128) for sight in seen)


def test_a_laser_that_is_dark_is_shown_and_ends_nothing():
    desk = Desk()
    desk.table.dead = True
    said, seen = aim(desk, 2)
    assert said == "" and [sight.proof.ok for sight in seen] == [False, False] and seen[0].proof.reason


def test_an_emergency_stop_ends_it_with_a_line():
    desk = Desk()

    def press(controller):
        controller.estop = True
        controller.fall_into(Fault.EMERGENCY_STOP)

    desk.controller.before_shot[1] = press
    said, _ = aim(desk, 5)
    assert "emergency stop" in said and dark(desk)


def test_a_link_that_is_lost_for_good_is_an_error_and_says_that_the_laser_may_be_on():
    desk = Desk()
    desk.controller.before_shot[1] = lambda controller: controller.lose_link(attempts=1000)
    said = []
    with pytest.raises(LinkLost, match="Could not confirm that the laser is off"):
        run_aiming(desk.config, desk.devices, said.append)


def test_an_interrupt_aborts():
    desk = Desk()

    def interrupt(controller):
        raise KeyboardInterrupt("now")

    desk.controller.before_shot[1] = interrupt
    with pytest.raises(KeyboardInterrupt, match="now"):
        aim(desk, 5)
    assert dark(desk) and "abort" in desk.controller.log
