"""The controller's verbs against a controller of Python on a clock of its own: answers, faults, losses, the way out."""

import random
import re
from itertools import pairwise

import pytest
from scanrig.controllers.controller import Settings, ShotDone
from scanrig.controllers.jxs.controller import JxsController
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.controllers.jxs.protocol import encode, seal, wire_settings
from scanrig.errors import (
    ControllerReset,
    Fault,
    FirmwareError,
    LinkLost,
    Reason,
    Refused,
    RigFault,
    RigTimeout,
)

from .fake import FakeController


@pytest.fixture
def fake():
    return FakeController()


@pytest.fixture
def controller(fake):
    controller = JxsController(fake, fake.clock, reopen=lambda: fake, session=5)
    controller.hello()
    controller.configure(Settings())
    controller.enable(True)
    controller.arm(True)
    controller.home(30000)
    return controller


def lossy(seed, share):
    """A line that flips one bit of a share of the bytes."""
    chance = random.Random(seed)

    def mangle(data):
        return bytes(b ^ (1 << chance.randrange(8)) if chance.random() < share else b for b in data)

    return mangle


def losing(part, count):
    """A line that loses the next `count` lines in which `part` is."""
    left = [count]

    def mangle(data):
        if part in data and left[0]:
            left[0] -= 1
            return b""
        return data

    return mangle


def test_an_uno_is_given_the_time_of_its_boot_loader(fake):
    fake.settings["motion"]["wd"] = 60000

    def asleep(data):
        return b"" if fake.clock.now() < 1.7 else data

    fake.out = b""
    fake.to_controller = asleep
    fake.due = (1.7, lambda: fake.tell("BOOT why=1 boot=7"))
    assert JxsController(fake, fake.clock).hello().boot == 7
    assert 1.7 < fake.clock.now() < 1.8


def test_settings_are_read_back(fake):
    controller = JxsController(fake, fake.clock)
    controller.hello()
    wanted = Settings(
        watchdog_ms=400,
        speed=5000,
        start_speed=300,
        acceleration=9000,
        home_speed=150,
        backlash=20,
        reverse=True,
        settle_ms=1,
        laser_on_ms=2,
        laser_off_ms=3,
        exposure_ms=4,
        gap_ms=5,
        ready_ms=6,
        limits=(-100, 29000),
    )
    controller.configure(wanted)
    assert fake.settings["motion"] == wire_settings(wanted)["motion"]
    assert fake.settings["shot"] == wire_settings(wanted)["shot"] | wire_settings(wanted)["limits"]
    fake.settings["motion"].pop("back")
    with pytest.raises(FirmwareError, match="back=nothing instead of 0"):
        controller.configure(Settings())


def test_the_longest_settings_fit_their_lines():
    most = (60000, 10000, 10000, 60000, 10000, 10000, True, 10000, 10000, 10000, 5000, 10000, 10000)
    for group in wire_settings(Settings(*most, limits=(-(2**31), -(2**31) + 1))).values():
        assert len(encode(65535, "SET", **group)) <= 97


@pytest.mark.parametrize("events_lost", [0, 1])
def test_home_says_what_the_counter_said(fake, controller, events_lost):
    fake.position += 3  # three steps that the counter knows nothing of
    fake.to_host = losing(b"!", events_lost)
    assert controller.home(30000) == -3
    assert controller.home(30000) == 0


def test_a_lost_event_is_asked_for(fake, controller):
    fake.to_host = losing(b"!", 1)
    controller.shot(800, 1)
    assert controller.wait_shot(1) == ShotDone(800, 2)
    assert controller.link_counts.events_missed == 1


def test_the_event_of_an_earlier_shot_ends_no_later_one(fake, controller):
    controller.shot(8, 1)
    fake.clock.sleep(0.3)
    controller.stat()  # its event has come by now, and is not read yet
    controller.shot(8000, 1)
    assert controller.wait_shot(1).position == 8000


def test_the_end_of_an_earlier_move_ends_no_later_one(fake, controller):
    def late(data):
        if b"MOVE" in data:
            fake.tell("DONE seq=9999 pos=7")
        return data

    fake.to_controller = late
    assert controller.move(4000) == fake.position == 4000


def test_the_link_watchdog_is_fed_while_something_runs(fake, controller):
    controller.move(20000)  # five seconds, of a watchdog of half a second
    assert fake.seconds_between_lines <= 0.15


def test_two_lines_lost_in_a_row_do_not_starve_the_watchdog(fake, controller):
    fake.to_controller = losing(b"STAT", 2)
    assert controller.move(8000) == 8000
    assert fake.seconds_between_lines <= 0.35


def test_numbers_of_lines_go_round(fake):
    wire = Exchange(fake, fake.clock, timeout_s=0.25, tries=8)
    wire.seq = 65534
    numbers = []
    for _ in range(2):
        wire.ask("STAT")
        numbers.append(wire.seq)
    assert numbers == [65535, 1]


def test_half_a_line_does_not_spoil_the_next(fake, controller):
    ends = [1]

    def lose_the_end(data):
        if ends[0]:
            ends[0] -= 1
            return data[:-5]
        return data

    fake.to_controller = lose_the_end
    controller.stat()
    assert controller.link_counts.resent == 1


@pytest.mark.parametrize("seed", range(5))
def test_noise_does_nothing_twice_and_leaves_nothing_out(fake, controller, seed):
    fake.to_controller, fake.to_host = lossy(seed, 0.005), lossy(seed + 100, 0.005)
    for k in range(1, 61):
        controller.shot(8 * k, k)
        assert controller.wait_shot(k).position == 8 * k
    assert (fake.pulses, fake.exposures, fake.position) == (60, 120, 480)
    assert [text for text in fake.carried_out if text.startswith("SHOT")] == [
        f"SHOT to={8 * k} id={k} m=3" for k in range(1, 61)
    ]
    assert controller.link_counts.resent > 4


def test_a_nak_asks_for_the_line_again_and_answers_nothing(fake, controller):
    damaged = [2]

    def damage(data):
        damaged[0] -= 1
        return data if damaged[0] < 0 else data.replace(b"STAT", b"STBT")

    fake.to_controller = damage
    before = fake.clock.now()
    assert controller.stat().state == "idle"
    assert controller.link_counts.naks == 2
    assert fake.clock.now() - before < 0.02  # at once, without waiting for an answer that will not come


def test_answers_to_other_lines_are_strays(fake, controller):
    fake.say(seal("=9999 err 4"))
    fake.say(seal("=0 ok st=fault"))
    assert controller.stat().state == "idle"
    assert controller.link_counts.strays == 2


def test_a_refusal_names_command_and_reason(fake, controller):
    controller.arm(False)
    with pytest.raises(Refused, match=r"'LASER on=1 ms=100': the laser is not armed \(error 14\)") as refusal:
        controller.laser(True, 100)
    assert refusal.value.reason is Reason.NOT_ARMED


@pytest.mark.parametrize("events_lost", [0, 1])
def test_a_fault_ends_the_wait_and_says_where(fake, controller, events_lost):
    controller.move(100)
    controller.shot(8000, 1)
    fake.to_host = losing(b"!", events_lost)
    fake.press(True)
    with pytest.raises(RigFault, match="fault at microstep 100: emergency stop") as fault:
        controller.wait_shot(1)
    assert (fault.value.fault, fault.value.position) == (Fault.EMERGENCY_STOP, 100)


def test_in_a_fault_commands_raise_the_fault(fake, controller):
    fake.press(True)
    with pytest.raises(RigFault, match=r"fault at microstep \d+: emergency stop"):
        controller.move(0)
    with pytest.raises(Refused, match="still pressed"):
        controller.clear()
    fake.press(False)
    controller.clear()
    with pytest.raises(Refused, match="driver is off"):
        controller.move(0)


def test_an_answer_older_than_an_event_is_no_reset(fake, controller):
    """The answer to STAT is lost, a fault comes, and the answer is repeated as it was."""
    lost = [1]

    def lose(data):
        if data.startswith(b"=") and lost[0]:
            lost[0] -= 1
            fake.fail(3)
            return b""
        return data

    fake.to_host = lose
    assert controller.stat().state == "idle"
    with pytest.raises(RigFault, match="lease"):
        controller.poll()
    assert controller.link_counts.events_missed == 0


def test_no_home_switch(fake, controller):
    fake.switch = False
    with pytest.raises(RigFault, match="home switch"):
        controller.home(30000)


def test_what_does_not_end_is_stopped(fake, controller):
    controller.shot(80000, 1)
    with pytest.raises(RigTimeout, match=r"shot 1 did not end within 3\.0 s; it was stopped"):
        controller.wait_shot(1, timeout_s=3.0)
    assert fake.state == "idle"


@pytest.mark.parametrize("reported", [True, False], ids=["by BOOT", "with BOOT lost"])
def test_a_reset_is_noticed_while_waiting(fake, controller, reported):
    controller.shot(8000, 1)
    fake.to_host = losing(b"!", 0 if reported else 1)
    fake.reset()
    with pytest.raises(ControllerReset, match="position and settings are gone"):
        controller.wait_shot(1)
    with pytest.raises(ControllerReset):
        controller.move(0)


def test_a_reset_at_rest_is_noticed_before_anything_moves(fake, controller):
    fake.to_host = losing(b"!", 1)
    fake.reset()
    with pytest.raises(ControllerReset):
        controller.shot(8, 1)
    assert fake.position == 0


def test_after_a_reset_settings_are_sent_and_home_is_asked_for(fake, controller):
    controller.configure(Settings(settle_ms=77))
    fake.reset()
    with pytest.raises(ControllerReset, match="boot 7 → 8"):
        controller.stat()
    found = controller.reconnect()
    assert (found.same_boot, not found.status.homed) == (False, True)
    assert fake.settings["shot"]["settl"] == 77
    controller.enable(True)
    controller.home(30000)


@pytest.mark.parametrize("pause_s", [0.0, 2.0], ids=["for a moment", "until the watchdog has stopped the table"])
def test_after_a_pulled_cable_the_position_is_still_good(fake, controller, pause_s):
    controller.move(400)
    controller.shot(8000, 1)
    fake.unplugged = True
    with pytest.raises(LinkLost, match="unplugged"):
        controller.wait_shot(1)
    fake.clock.sleep(pause_s)
    fake.unplugged = False
    found = controller.reconnect()
    assert (found.same_boot, found.status.homed) == (True, True)
    assert (found.status.state, found.status.fault) == ("idle", None)
    controller.arm(True)
    controller.shot(8000, 1)
    assert controller.wait_shot(1).position == fake.position == 8000


def test_reconnecting_backs_off_and_gives_up(fake, controller):
    fake.unplugged = True
    opened = []

    def reopen():
        opened.append(fake.clock.now())
        return fake

    lost = JxsController(fake, fake.clock, reopen=reopen)
    before = fake.clock.now()
    with pytest.raises(LinkLost, match="did not come back within 20 s"):
        lost.reconnect(timeout_s=20.0)
    pauses = [b - a for a, b in pairwise(opened)]
    assert pauses == sorted(pauses) and pauses[-1] == pytest.approx(2.0)
    assert fake.clock.now() - before <= 20.0


def test_a_silent_controller_is_lost_in_two_seconds(fake, controller):
    fake.to_host = lambda data: b""
    before = fake.clock.now()
    with pytest.raises(LinkLost, match="no answer from fake to 'STAT'"):
        controller.stat()
    assert fake.clock.now() - before == pytest.approx(2.0, abs=0.3)


def test_hello_says_who_is_there_and_refuses_another_protocol(fake):
    firmware = JxsController(fake, fake.clock).hello()
    assert (firmware.proto, firmware.version, firmware.boot, firmware.lease_ms) == (1, "9.9.9", 7, 1000)
    fake.proto = 2
    with pytest.raises(FirmwareError, match=r"firmware 9\.9\.9 that speaks protocol 2, needed protocol 1"):
        JxsController(fake, fake.clock).hello()


@pytest.mark.parametrize(
    ("answer", "said", "within_s"),
    [
        (lambda data: b"", "found silence, needed a scanner controller", 6.0),
        (lambda data: data, "echoes its input", 1.0),
        (lambda data: b"Grbl 1.1h ['$' for help]\r\nerror:1\r\n", "a device that sends 'error:1'", 6.0),
    ],
    ids=["silence", "echo", "another device"],
)
def test_another_device_is_described(fake, answer, said, within_s):
    fake.out = b""
    fake.write = lambda data: setattr(fake, "out", answer(data))
    with pytest.raises(FirmwareError, match=said):
        JxsController(fake, fake.clock).hello()
    assert fake.clock.now() < within_s


def test_making_safe_ends_a_shot(fake, controller):
    controller.shot(8000, 1)
    assert controller.make_safe()
    assert fake.state == "idle" and not fake.armed and fake.exposures == 0


def test_making_safe_after_half_a_line(fake, controller):
    controller.laser(True)
    real, fake.write = fake.write, None

    def interrupted(data):
        real(data[:9])
        fake.write = real
        raise KeyboardInterrupt

    fake.write = interrupted
    with pytest.raises(KeyboardInterrupt):
        controller.stat()
    assert controller.make_safe()
    assert not fake.laser and fake.fault == 0


def test_without_answers_making_safe_aborts(fake, controller):
    controller.laser(True)
    fake.to_controller = lambda data: data if data == b"\x1b" else b""
    before = fake.clock.now()
    assert not controller.make_safe()
    assert fake.fault in (2, 5) and not fake.laser
    assert fake.clock.now() - before < 2.0


@pytest.mark.parametrize("answer", ["", " st=idle f=0", " st=idle f=x pos=0"])
def test_a_state_that_cannot_be_read_is_no_reason_not_to_abort(fake, controller, answer):
    """The line is whole, and says nothing that a state says: nobody knows whether the laser is off."""
    real = fake.write

    def odd(data):
        if b" STAT*" not in data:
            real(data)
        else:
            number = data.strip().partition(b" ")[0][1:].decode()
            fake.say(seal(f"={number} ok{answer}"))

    fake.write = odd
    assert not controller.make_safe()
    assert fake.fault == 5 and not fake.laser and not fake.armed


def test_what_could_not_be_made_safe_does_not_hide_the_error(fake):
    with pytest.raises(ZeroDivisionError) as error, JxsController(fake, fake.clock) as controller:
        controller.hello()
        fake.unplugged = True
        raise ZeroDivisionError
    assert any("by hand" in note for note in error.value.__notes__)


def test_events_count_on_after_the_last_number(fake, controller):
    fake.events = 65533
    fake.tell("TESTED seq=1")
    controller.stat()
    before = controller.link_counts.events_missed
    for k in range(4):
        controller.shot(8, k)
        controller.wait_shot(k)
    controller.stat()
    assert fake.events == 3
    assert controller.link_counts.events_missed == before


def test_a_driver_that_the_emergency_stop_switched_off_is_no_reset(fake, controller):
    controller.shot(8000, 1)
    fake.press(True)
    with pytest.raises(RigFault):
        controller.wait_shot(1)
    fake.press(False)
    controller.clear()
    assert not controller.stat().enabled


@pytest.mark.parametrize("was", ["9" * 60, "1_000", "0x10", "1e3", "-"])
def test_a_number_that_no_firmware_has_is_one_line(fake, controller, was):
    tell = fake.tell
    fake.tell = lambda text: tell(re.sub("was=.*", f"was={was}", text))
    with pytest.raises(FirmwareError, match=r"says was=.* expected an integer") as problem:
        controller.home(30_000)
    assert len(str(problem.value)) < 200 and "\n" not in str(problem.value)
