"""Aiming: pairs at home, again and again, with the laser off at the end however it ends."""

import pytest
from scanrig.errors import Fault, LinkLost
from scanrig.session import Hooks, Wish, run_aiming

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


def aim_by_hand(desk, wishes, after=lambda looks: None):
    """What is seen with one wish after the other, and what is said."""
    seen, said = [], []

    def see(sight):
        seen.append(sight)
        after(len(seen))

    hooks = Hooks(notify=said.append, should_stop=lambda: len(seen) >= len(wishes))
    assert run_aiming(desk.config, desk.devices, see, hooks, lambda: wishes[len(seen)]) == ""
    return seen, said


def test_the_table_goes_where_it_may_and_the_laser_stays_dark_where_it_should():
    desk = Desk(turntable={"limits_deg": [-20.0, 90.0]})
    desk.controller.trigger = lambda: desk.camera.expose(desk.table.position, desk.table.shines)
    contactor = []
    wishes = [Wish(), Wish(45.0), Wish(400.0), Wish(45.0, lit=False), Wish(10.0, lit=False), Wish(10.0)]
    seen, _ = aim_by_hand(desk, wishes, lambda looks: contactor.append(desk.table.contactor))
    assert [sight.angle_deg for sight in seen] == [0.0, 45.0, 90.0, 45.0, 10.0, 10.0]
    assert contactor == [True, True, True, False, False, True] and dark(desk)
    assert [sight.on is None for sight in seen] == [False, False, False, True, True, False]
    assert seen[4].off.shape == (96, 128) and seen[5].proof.ok


def test_another_exposure_is_taken_with_the_laser_off_and_one_that_is_refused_changes_nothing():
    desk = Desk()
    reopened, adopt = [], desk.camera.adopt

    def adopted(settings):
        reopened.append((settings.exposure_ms, bool(desk.table.laser), desk.table.contactor))
        adopt(settings)

    desk.camera.adopt = adopted
    seen, said = aim_by_hand(desk, [Wish(), Wish(exposure_ms=20.0, gain_db=3.0), Wish(exposure_ms=20.0, gain_db=3.0)])
    assert reopened == [(20.0, False, False)] and said == [] and all(sight.proof.ok for sight in seen)
    assert desk.camera.features()["exposure_s"] == 0.02 and desk.controller.settings.exposure_ms == 20

    def refuse(settings):
        reopened.append(settings.exposure_ms)
        desk.camera.after_reopen = {"exposure_s": 0.02}
        adopt(settings)

    desk.camera.adopt = refuse
    before = len(reopened)
    wishes = [Wish(exposure_ms=20.0, gain_db=3.0), *3 * [Wish(exposure_ms=700.0, gain_db=3.0)]]
    desk.config = desk.config.model_copy(update={"camera": desk.camera.settings})
    seen, said = aim_by_hand(desk, wishes)
    # Asked once; the former one is back, and is what the controller times its pulses by.
    assert reopened[before:] == [700.0, 20.0] and len(said) == 1 and said[0].endswith("The former exposure stays.")
    assert desk.controller.settings.exposure_ms == 20 and seen[-1].proof.ok and dark(desk)
