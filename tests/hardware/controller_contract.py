"""The contract of every controller: inherit `ControllerContract` and give it a `plant`.

A plant has a `controller` that is open and not greeted yet, a `config` of 28800 microsteps a turn, `position()` and
`lit()` for the true state, and `reset()`, `unplug()`, `plug()`, `fault()`, `wait(seconds)` for faults.
`fault` makes it stop by itself and names the fault.
"""

import pytest
from scanrig.controllers import Settings
from scanrig.errors import ControllerReset, LinkLost, Reason, Refused, RigError, RigFault


SETTINGS = Settings(speed=8000, limits=(-2000, 30000))
NEAR = 1
"""Largest difference of reported and true position [microsteps]: GRBL prints three decimals of a degree."""


class ControllerContract:
    @pytest.fixture
    def plant(self):
        raise NotImplementedError

    @pytest.fixture
    def controller(self, plant):
        """Greeted, set, enabled, armed, homed."""
        controller = plant.controller
        controller.hello()
        controller.configure(SETTINGS)
        self.make_ready(controller)
        return controller

    def make_ready(self, controller):
        controller.enable(True)
        controller.home(40000)
        controller.arm(True)

    def test_before_it_is_homed_home_is_not_known(self, plant):
        firmware = plant.controller.hello()
        assert firmware.version and isinstance(firmware.boot, int)
        plant.controller.configure(SETTINGS)
        status = plant.controller.stat()
        assert (status.state, status.fault, status.homed, status.armed) == ("idle", None, False, False)

    def test_it_turns_to_a_position_and_reports_it(self, plant, controller):
        home = plant.position()
        assert controller.stat().homed and controller.stat().position == 0
        for to in (800, 7, 1234, -500):
            assert controller.move(to) == to == controller.stat().position
            assert plant.position() - home == pytest.approx(to, abs=NEAR)

    def test_home_is_found_again(self, plant, controller):
        home = plant.position()
        controller.move(900)
        was = controller.home(40000)
        assert was == (0 if controller.guarantees.knows_missed_steps else None)
        assert controller.stat().position == 0 and plant.position() == pytest.approx(home, abs=NEAR)

    def test_beyond_the_limits_nothing_moves(self, plant, controller):
        before = plant.position()
        with pytest.raises(Refused) as refused:
            controller.move(30001)
        assert refused.value.reason is Reason.BEYOND_LIMIT and plant.position() == before

    def test_a_driver_that_is_off_forgets_home_and_moves_nothing(self, plant, controller):
        controller.enable(False)
        assert not controller.stat().homed
        with pytest.raises(Refused) as refused:
            controller.move(100)
        assert refused.value.reason is Reason.DRIVER_OFF

    def test_the_laser_shines_on_command_and_only_when_armed(self, plant, controller):
        assert not plant.lit()
        controller.laser(True)
        assert plant.lit() and controller.stat().laser
        controller.laser(False)
        assert not plant.lit() and not controller.stat().laser
        controller.arm(False)
        with pytest.raises(Refused) as refused:
            controller.laser(True)
        assert refused.value.reason is Reason.NOT_ARMED and not plant.lit()

    def test_an_unknown_laser_stays_dark(self, plant, controller):
        with pytest.raises(Refused):
            controller.laser(True, number=99)
        assert not plant.lit()

    def test_disarming_puts_the_laser_off(self, plant, controller):
        controller.laser(True)
        controller.arm(False)
        assert not plant.lit()

    def test_stop_puts_the_laser_off_and_keeps_home(self, plant, controller):
        controller.laser(True)
        controller.stop()
        assert not plant.lit() and controller.stat().homed
        assert controller.move(300) == 300

    def test_a_fault_has_a_name_and_is_dark_and_can_be_left(self, plant, controller):
        controller.laser(True)
        fault = plant.fault()
        with pytest.raises(RigFault) as raised:
            controller.poll()
        assert raised.value.fault is fault and str(fault) in str(raised.value)
        assert not plant.lit() and controller.stat().fault is fault
        plant.release()
        controller.clear()
        assert controller.stat().fault is None
        self.make_ready(controller)
        assert controller.move(250) == 250

    def test_a_reset_is_noticed_and_asks_for_home(self, plant, controller):
        plant.reset()
        with pytest.raises(ControllerReset):
            for _ in range(5):
                controller.poll()
                plant.wait(0.1)
        found = controller.reconnect(20.0)
        assert (found.same_boot, not found.status.homed, found.status.armed) == (False, True, False)
        self.make_ready(controller)
        assert controller.move(400) == 400 == controller.stat().position

    def test_a_cable_that_comes_back_leaves_the_position_good(self, plant, controller):
        controller.move(640)
        before = plant.position()
        plant.unplug()
        with pytest.raises(LinkLost):
            controller.poll()
        plant.plug()
        found = controller.reconnect(20.0)
        assert (found.same_boot, not found.status.homed, found.status.state) == (True, False, "idle")
        assert found.status.position == 640 and plant.position() == before
        controller.arm(True)
        assert controller.move(0) == 0

    def test_its_counts_distinguish_answers_from_silence(self, plant, controller):
        controller.poll()
        assert controller.link_counts.unanswered == 0
        plant.unplug()
        with pytest.raises(LinkLost):
            controller.poll()
        assert controller.link_counts.unanswered > 0
        with pytest.raises(LinkLost):
            controller.reconnect(1.0)
        assert controller.link_counts.unanswered > 0
        plant.plug()
        controller.reconnect(20.0)
        assert controller.link_counts.unanswered == 0

    def test_a_cable_that_stays_away_is_given_up(self, plant, controller):
        plant.unplug()
        with pytest.raises(LinkLost, match="did not come back within 1 s"):
            controller.reconnect(1.0)

    def test_made_safe_is_dark(self, plant, controller):
        controller.laser(True)
        assert controller.make_safe() and not plant.lit()

    def test_without_a_cable_nothing_is_confirmed(self, plant, controller):
        controller.laser(True)
        plant.unplug()
        assert controller.make_safe() is False
        with pytest.raises(RigError, match="switch its supply off by hand"):
            controller.close()
        controller.close()

    @pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
    def test_every_way_out_is_dark(self, plant, controller, error):
        with pytest.raises(error), controller:
            controller.laser(True)
            assert plant.lit()
            raise error
        assert not plant.lit()

    def test_abort_is_dark_without_an_answer(self, plant, controller):
        controller.laser(True)
        controller.abort()
        plant.wait(0.3)
        assert not plant.lit() and controller.make_safe()

    def test_it_keeps_its_guarantees_without_a_host(self, plant, controller):
        controller.laser(True)
        plant.wait(1.5)
        assert plant.lit() is not controller.guarantees.laser_off_without_host

    def test_it_has_the_trigger_that_it_guarantees(self, plant, controller):
        if controller.guarantees.hardware_trigger:
            controller.shot(160, 1)
            assert controller.wait_shot(1).position == 160
        else:
            for ask in (controller.trigger, lambda: controller.shot(160, 1), lambda: controller.wait_shot(1)):
                with pytest.raises(Refused) as refused:
                    ask()
                assert refused.value.reason is Reason.NO_SUCH_PART
        assert not plant.lit()
