"""The report of a recalibration: complete, without external parts, safe with hostile names, honest numbers."""

import dataclasses

import numpy as np
import pytest

from jaxscan.recalibration import Drift, FoundLength, Gain, Moved
from jaxscan.report.recalibration import drift_words, gain_lines, plots, recalibration_page, words

from .conftest import make_calibration
from .made_recalibration import BEND_M, WALL_M, make_panorama, make_recalibration
from .test_calibration_page import Document, assert_alone


SECTIONS = ["In words", "Flatness of the walls", "What was gained", "What moved", "Stations"]


@pytest.fixture(scope="module")
def result():
    return make_recalibration(make_calibration().scanner, stations=2)


def test_every_section_is_there_and_nothing_is_fetched(result):
    text = recalibration_page(result, title="old.json with room", notes=("a note",))
    document = Document(text)
    assert_alone(text, document)
    assert document.words["h2"] == SECTIONS
    assert "The rig has drifted: the plane of laser red moved by 0.050 degrees (p < 1e-6)" in document.all_words()
    assert text.count("data:image/png;base64") >= 2
    assert "Root mean square distance 1.1 mm before, 0.40 mm now" in text


def test_sections_without_data_are_left_out(result):
    bare = dataclasses.replace(
        result, panoramas=(), gains=(), moved=(), closure=None, hold_out=None, lengths=(), unobserved=(), notes=()
    )
    bare = dataclasses.replace(bare, table=dataclasses.replace(bare.table, sentences=()))
    alone = {"stations": np.eye(4)[None], "station_covariance": np.zeros((1, 6, 6))}
    bare = dataclasses.replace(bare, adjusted=dataclasses.replace(bare.adjusted, **alone))
    assert "h2" not in Document(recalibration_page(bare)).words


def test_hostile_names_are_text(result):
    name = '<script>alert(1)</script>"&'
    hostile = dataclasses.replace(
        result,
        panoramas=(dataclasses.replace(result.panoramas[0], sweep=name),),
        moved=(dataclasses.replace(result.moved[0], name=f"laser {name}: $n_1$"),),
        gains=(Gain(name, 1.0, 0.5),),
        unobserved=(name,),
        notes=(name,),
        drift=dataclasses.replace(result.drift, part=f"laser {name}"),
    )
    text = recalibration_page(hostile, title=name)
    document = Document(text)
    assert "script" not in document.tags
    assert name in document.all_words()


def test_both_pictures_of_the_walls_are_means_in_millimetres():
    panorama = make_panorama()
    before, after = plots.panorama_rows(panorama)
    assert before.shape == after.shape == (96, 120)
    np.testing.assert_allclose(before[:, 3], 1e3 * panorama.before[3], atol=1e-9)
    assert np.isnan(before[45, 25]) and np.isnan(after[45, 25])
    assert plots.colour_limit([before, after]) == 5.0 and 1e3 * BEND_M < 5.0


def test_a_large_panorama_is_averaged_and_placed_by_its_angles():
    profiles, lines = 2400, 1000
    angle = np.linspace(0, 2 * np.pi, profiles, endpoint=False)[::-1]
    field = np.tile((1e-3 * angle)[:, None], (1, lines))
    panorama = dataclasses.replace(
        make_panorama(), before=field, after=0 * field, seen=np.ones(field.shape, bool), angle=angle
    )
    before, after = plots.panorama_rows(panorama)
    assert before.shape == (plots.ROWS, plots.COLUMNS)
    # The middle of each column in azimuth, to half a column.
    np.testing.assert_allclose(before[0], 2 * np.pi * (np.arange(plots.COLUMNS) + 0.5) / plots.COLUMNS, atol=3e-3)
    assert not after.any()


def test_flatness_is_the_root_mean_square_of_seen_points():
    panorama = make_panorama()
    _, after = words.flatness_mm(panorama)
    assert after == pytest.approx(1e3 * np.sqrt(np.mean(panorama.after[panorama.seen] ** 2)))
    # 10,920 normal numbers: their standard deviation is known to 0.7 %; five times that.
    assert after == pytest.approx(1e3 * WALL_M, rel=0.035)
    nothing = dataclasses.replace(panorama, seen=np.zeros(panorama.seen.shape, bool))
    assert np.isnan(words.flatness_mm(nothing)).all()


@pytest.mark.parametrize(
    ("drift", "text"),
    [
        (Drift(20.0, 20, 0.4312, False), "The rig is as it was calibrated (p = 0.43)"),
        (Drift(90.0, 20, 3e-4, True), "The rig has drifted, and no single part explains it (p = 0.0003)"),
        (
            Drift(90.0, 20, 1e-30, True, "axis", "0.20 mm"),
            "The rig has drifted: the axis of the table moved by 0.20 mm (p < 1e-6)",
        ),
        (
            Drift(90.0, 20, 1e-9, True, "laser red and axis", "laser red 0.05 degrees; axis 0.2 mm"),
            "The rig has drifted: the plane of laser red and the axis of the table moved (laser red 0.05 degrees; axis "
            "0.2 mm) (p < 1e-6)",
        ),
        (
            Drift(90.0, 20, 1e-9, True, "laser red or axis", "0.05 degrees, 0.1 mm or 0.2 degrees"),
            "The rig has drifted: the plane of laser red moved by 0.05 degrees, 0.1 mm, or the axis of the table moved "
            "by 0.2 degrees; these sweeps cannot tell which (p < 1e-6)",
        ),
        (
            Drift(90.0, 20, 1e-9, True, "laser red and camera or axis and camera", "a 1 mm; b 2 px or c 3 mm; b 4 px"),
            "The rig has drifted: the plane of laser red and the camera moved (a 1 mm; b 2 px), or the axis of the "
            "table and the camera moved (c 3 mm; b 4 px); these sweeps cannot tell which (p < 1e-6)",
        ),
        (Drift(90.0, 20, 1e-30, True, "camera"), "The rig has drifted: the camera moved (p < 1e-6)"),
    ],
)
def test_the_verdict_on_drift(drift, text):
    assert drift_words(drift) == text


def test_gains_are_in_words():
    gains = (Gain("radial scale", 120.0, 119.9, "ppm"), Gain("a", 1.0, 0.5), Gain("b", 1.0, 0.01), Gain("c", 1.0, 1.0))
    assert gain_lines(gains) == [
        "radial scale: as well known as before, 120 ppm",
        "b: 100 times better known",
        "a: 2.0 times better known",
    ]


def test_a_motion_has_its_sign_and_unit():
    tilt = Moved("laser.red.n1", 0.0, -8.727e-4, 1e-3, 1e-4, -9.0, "degrees", float(np.degrees(1.0)))
    moved = (tilt, Moved("k1", 0.0, 1.0, 1.0, 1.0, 2.0))
    first, second = words.moved_rows(moved)
    assert first == ("laser.red.n1, degrees", "0", "-0.05000203", "0.057", "0.0057", "-9.0")
    assert second[0] == "k1" and second[-1] == "+2.0"


def test_known_lengths_are_told_with_their_residuals(result):
    known = dataclasses.replace(result, known=(FoundLength(3.82, 1e-3, 3.8212),))
    assert words.known_lines(known) == ["known length 3.8200 m: found 3.8212 m, +1.20 mm (given to 1.0 mm)"]
    assert "found 3.8212 m" in recalibration_page(known)
