"""A rig's configuration: short files suffice, and nothing is accepted that cannot be meant."""

from pathlib import Path

import pytest
from scanrig.config import load_rig
from scanrig.session.plan import controller_settings

from jaxscan.errors import ConfigError


CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SHORT = '[camera]\nkind = "simulated"\nwidth = 640\nheight = 480\n'


def load(tmp_path, text):
    (tmp_path / "rig.toml").write_text(text)
    return load_rig(tmp_path / "rig.toml")


def test_a_short_file_suffices(tmp_path):
    rig = load(tmp_path, SHORT)
    assert rig.microsteps_per_turn == 3200 and rig.controller.port == "auto"
    assert (rig.laser[0].line.name, rig.laser[0].line.colour) == ("laser", "red")
    assert (rig.sweep.steps, rig.sweep.turn_deg, rig.checks.retakes) == (3600, 360.0, 3)


def test_one_laser_table_is_a_list_of_one(tmp_path):
    for brackets in ("[laser]", "[[laser]]"):
        rig = load(tmp_path, SHORT + f'{brackets}\nname = "green"\ncolour = "green"\non_ms = 5\n')
        assert (rig.laser[0].name, rig.laser[0].on_ms, rig.laser[0].table.colour) == ("green", 5, "green")


@pytest.mark.parametrize(
    ("gear", "microsteps"), [("[9, 1]", 28800), ("[1, 1]", 3200), ("[60, 16]", 12000), ("[5, 2]", 8000)]
)
def test_gears_are_whole_numbers(tmp_path, gear, microsteps):
    assert load(tmp_path, SHORT + f"[turntable]\ngear = {gear}\n").microsteps_per_turn == microsteps


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[turntable]\ngear = [50, 17]\n", r"turntable: gear: .* = 9411\.765 microsteps per turn, expected a whole"),
        ("[turntable]\ngear = [0, 1]\n", "expected two integers of 1"),
        ("[turntable]\ngear = [9.0, 1]\n", r"turntable.gear\[0\]: found 9.0"),
        ("[turntable]\ngear = [100000, 1]\n", "microsteps per turn, expected 8 ... 10000000"),
        ("[turntable]\nspeed_deg_s = 2000.0\n", "turntable.speed_deg_s: found 2000.0"),
        ("[turntable]\ngear = [9, 1]\nspeed_deg_s = 500.0\n", r"which is 40000 microsteps .* so 0.625 ... 125"),
        ("[turntable]\nstart_speed_deg_s = 60.0\n", "start_speed_deg_s: found more than speed_deg_s"),
        ("[turntable]\nlimits_deg = [10, 20]\n", "with home, 0, within"),
        ("[turntable]\nspeed_mm_s = 3\n", r"turntable.speed_mm_s: unknown key; the closest known one is"),
        ("[sweep]\nturn_deg = 0\n", "turn_deg: found 0, expected an angle"),
        ("[sweep]\nturn_deg = 720\n", "sweep.turn_deg: found 720"),
        ("[sweep]\nsteps = 0\n", "sweep.steps: found 0"),
        ("[sweep]\nsteps = 1.5\n", "sweep.steps: found 1.5"),
        ("[calibration]\nangles_deg = [0.0]\n", "calibration.angles_deg"),
        ("[laser]\non_ms = -1\n", r"on_ms: found -1"),
        ('[[laser]]\nname = "a"\n[[laser]]\nname = "a"\n', "laser: found a and a, expected a different name for each"),
        ('[[laser]]\nname = "a"\n[[laser]]\nname = "b"\n[[laser]]\nname = "c"\n', "laser"),
        ("[checks]\nretakes = 101\n", "checks.retakes: found 101"),
        ("[checks.proof]\nlit_lines = 2.0\n", "checks.proof.lit_lines: found 2.0"),
        ("[controller]\nwatchdog_ms = 50\n", "controller.watchdog_ms: found 50"),
        ("[board]\nsquare_mm = 30.0\n", "board"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(tmp_path, text, says):
    with pytest.raises(ConfigError, match=says) as caught:
        load(tmp_path, SHORT + text)
    assert "\n" not in str(caught.value) and "rig.toml" in str(caught.value)


def test_frames_are_large_enough_for_a_line_with_its_sides(tmp_path):
    with pytest.raises(ConfigError, match="found 640 x 60 px, expected 64 px at least"):
        load(tmp_path, SHORT.replace("480", "60"))


def test_a_trigger_pulse_is_as_long_as_the_exposure_or_as_it_is_said(tmp_path):
    assert (
        controller_settings(load(tmp_path, SHORT.replace("[camera]", "[camera]\nexposure_ms = 7.2"))).exposure_ms == 8
    )
    text = SHORT.replace("[camera]", "[camera]\nexposure_ms = 8000.0")
    with pytest.raises(ConfigError, match=r"give trigger\.pulse_ms"):
        load(tmp_path, text)
    assert controller_settings(load(tmp_path, text + "[trigger]\npulse_ms = 2\n")).exposure_ms == 2


def test_moderate_speeds_fit_every_table(tmp_path):
    for full_steps, microsteps, gear in ((200, 1, 1), (200, 16, 9), (400, 256, 90), (4, 2, 1)):
        rig = load(
            tmp_path,
            SHORT + f"[turntable]\nfull_steps = {full_steps}\nmicrosteps = {microsteps}\ngear = [{gear}, 1]\n",
        )
        settings = controller_settings(rig)
        assert 50 <= settings.speed <= 10_000 and 20 <= settings.start_speed <= settings.speed
        assert 100 <= settings.acceleration <= 60_000 and 20 <= settings.home_speed <= 10_000


def test_settings_in_the_controllers_own_units(tmp_path):
    rig = load(
        tmp_path,
        SHORT + "[turntable]\ngear = [9, 1]\nspeed_deg_s = 30.0\nbacklash_deg = 0.5\n"
        "limits_deg = [-5.01, 365.0]\nreverse = true\n"
        "[laser]\non_ms = 11\noff_ms = 12\n[trigger]\ngap_ms = 3\nready_ms = 40\n[controller]\nwatchdog_ms = 700\n",
    )
    settings = controller_settings(rig)
    assert (settings.speed, settings.backlash, settings.limits) == (2400, 40, (-400, 29200))
    assert (settings.laser_on_ms, settings.laser_off_ms, settings.exposure_ms) == (11, 12, 10)
    assert (settings.gap_ms, settings.ready_ms, settings.watchdog_ms, settings.reverse) == (3, 40, 700, True)


def test_a_digest_changes_with_what_frames_depend_on_and_with_nothing_else(tmp_path):
    def digest(text, kind="sweep"):
        return load(tmp_path, text).digest(kind)

    one = digest(SHORT)
    assert digest("# a remark\n" + SHORT) == one
    assert digest(SHORT.replace("[camera]", '[camera]\nid = "elsewhere"')) == one
    for same in ('[controller]\nport = "/dev/x"\n', "[checks]\nretakes = 9\n", "[calibration]\nfree_views = 2\n"):
        assert digest(SHORT + same) == one
    for other in (
        "[sweep]\nsteps = 7\n",
        "[turntable]\nsettle_ms = 1\n",
        "[laser]\noff_ms = 1\n",
        "[trigger]\ngap_ms = 6\n",
    ):
        assert digest(SHORT + other) != one
    assert digest(SHORT + "[calibration]\nfree_views = 2\n", "calibration") != digest(SHORT, "calibration")
    assert digest(SHORT + "[sweep]\nsteps = 7\n", "calibration") == digest(SHORT, "calibration")


def test_the_example_is_a_real_rig(tmp_path):
    rig = load_rig(CONFIGS / "scan.toml")
    assert rig.camera.kind == "aravis" and rig.camera.trigger == "hardware" and rig.microsteps_per_turn == 28800
    assert rig.turntable.limits_deg is not None and rig.board is not None
