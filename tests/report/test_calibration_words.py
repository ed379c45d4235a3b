"""Words and rows about a calibration."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import Missed, Quality, SecondLook
from jaxscan.calibration.result import BoardMap, GoodTo, GoodToPart, Lengths, LengthSigma, judge_views
from jaxscan.geometry import Hand
from jaxscan.report import Parameter, outcome_rows, parameters, quality_rows, words
from jaxscan.report.tables import view_rows


def having(calibration, **quality):
    return replace(calibration, quality=replace(calibration.quality, **quality))


def judged(calibration, tests=None, **verdict):
    """With other tests, and other parts of the verdict."""
    changed = verdict if tests is None else {**verdict, "tests": tuple(tests)}
    return having(calibration, verdict=replace(calibration.quality.verdict, **changed))


def structured(calibration, **effects):
    """With structure in some tests, by their names: their part of the error in mm; px are a tenth of that."""
    return [
        replace(test, p_structure=1e-5, effect_mm=effects[test.name], effect_px=0.1 * effects[test.name])
        if test.name in effects
        else test
        for test in calibration.quality.verdict.tests
    ]


class TestHeadline:
    def test_without_structure(self, calibration):
        found = words.headline(calibration)
        assert found == words.Headline(
            "plain", "Good to 0.80 mm at 2.5 m", "The residuals look like noise. Its rays are good to 0.1 px."
        )

    def test_poses_of_a_hand_are_in_the_first_sentence(self, calibration):
        hand = replace(calibration.scanner, turntable=Hand.mounted(np.eye(4), (1e-4, 5e-4)))
        found = words.headline(replace(calibration, scanner=hand))
        assert found.headline == (
            "Good to 0.80 mm at 2.5 m within one profile, and each pose of the hand adds 1.3 mm at 2.5 m"
        )
        assert "Each pose of the hand is off by 0.10 mm and 0.029 degrees." in found.explanation

    def test_a_limit_that_was_set_and_is_kept_makes_it_good(self, calibration):
        for settings, kind in (({"limit_mm": 1.0}, "good"), ({"limit_mm": None}, "plain"), ("nonsense", "plain")):
            assert words.headline(replace(calibration, provenance={"settings": settings})).kind == kind

    def test_says_which_length_its_largest_part_and_what_would_halve_it(self, calibration):
        parts = (GoodToPart("angles", 1.9), GoodToPart("sheet", 0.6), GoodToPart("axis", 0.01))
        whole = float(np.hypot(1.9, 0.6))
        good_to = GoodTo(whole, whole, 2.5, 0.1, 0.1, 4.0, parts)
        wall = LengthSigma("wall", 2.5, 4.0, whole)
        lengths = Lengths(tuple(replace(one, lengths=(wall, *one.lengths)) for one in calibration.quality.lasers()))
        found = having(judged(calibration, good_to=good_to), lengths=lengths)
        first = words.headline(found)
        assert first.headline == "Good to 2.0 mm for a 4 m wall from 2.5 m"
        assert "Its largest part, 1.9 mm, comes from the angles of the table; what would halve it: boards" in (
            first.explanation
        )
        # The figure of the verdict is the first line, and the squares of the next ones make it up.
        lines = words.lengths(found)
        assert [line.what for line in lines[:3]] == [
            "4 m wall from 2.5 m, laser red", "of that from the angles of the table", "of that from the laser's sheet"
        ]  # fmt: skip
        assert lines[0].sigma_mm == whole == pytest.approx(np.hypot(lines[1].sigma_mm, lines[2].sigma_mm))
        alike = replace(good_to, parts=(GoodToPart("camera", 1.5), GoodToPart("sheet", 1.3)))
        said = words.headline(judged(found, good_to=alike)).explanation
        assert "comes from camera and lens; no part alone would halve it, and the first step is: more boards" in said
        swept = replace(judged(found, good_to=good_to), provenance={"recalibration": {}})
        assert "what would halve it: more sweeps" in words.headline(swept).explanation

    def test_a_wrong_model_may_be_the_largest_part(self, calibration):
        good_to = GoodTo(1.0, 0.3, 2.5, 0.1, 0.1, 4.0, (GoodToPart("angles", 0.3),))
        found = judged(calibration, structured(calibration, lens=0.95), good_to=good_to)
        said = words.headline(found).explanation
        assert "That is its largest part; what would halve it: Capture the board in the corners" in said

    def test_of_a_camera_alone(self, calibration):
        alone = GoodTo(sigma_px=0.123, statistical_px=0.05)
        tests = structured(calibration, lens=1.0)
        tests[0] = replace(tests[0], effect_mm=None, where="in the corners")
        found = words.headline(judged(calibration, tests, good_to=alone))
        assert found.headline == (
            "Good to 0.12 px over the image; 0.1 px of that because the lens model falls short in the corners"
        )
        assert found.explanation == "All sigmas include this; noise alone would give 0.05 px."

    @pytest.mark.parametrize(("index", "name"), list(enumerate(words.TESTS)))
    def test_says_the_cause_and_its_size(self, calibration, index, name):
        found = words.headline(judged(calibration, structured(calibration, **{name: 0.5})))
        assert found.kind == "plain"
        for other, (_, cause) in words.TESTS.items():
            assert (f"; 0.50 mm of that because {cause}" in found.headline) == (other == name)

    def test_the_largest_cause_comes_first_and_small_ones_are_not_named(self, calibration):
        tests = structured(calibration, lens=0.3, board=0.6, axis=0.2)
        assert words.headline(judged(calibration, tests)).headline == (
            "Good to 0.80 mm at 2.5 m; 0.60 mm of that because the board is not flat (its shape could not be found), "
            "and 0.30 mm because the lens model falls short"
        )
        assert [row[6] for row in outcome_rows(judged(calibration, tests))].count("structure") == 3
        assert [row[5] for row in outcome_rows(judged(calibration, tests))][:3] == [
            "0.3 mm, 0.03 px", "0.6 mm, 0.06 px", ""
        ]  # fmt: skip

    def test_a_board_whose_shape_was_freed(self, calibration):
        freed = judged(calibration, structured(calibration, board=0.6))
        found = words.headline(having(freed, board=BoardMap("corners", 2.5e-4)))
        assert "because the board's shape falls short, though it was freed" in found.headline
        assert "The board's shape was freed: 0.25 mm RMS off flat." in found.explanation
        held = words.headline(having(freed, board=BoardMap("parabola", 2.5e-4)))
        assert "because the board is not flat (its shape could not be found)" in held.headline
        assert "freed" not in held.explanation

    def test_noise_without_structure_is_told_from_a_wrong_model(self, calibration):
        tests = [replace(test, p=1e-9) for test in calibration.quality.verdict.tests]
        noisy = judged(calibration, tests)
        found = words.headline(noisy)
        assert found.kind == "plain" and "larger than the detectors promise" in found.explanation
        assert {row[6] for row in outcome_rows(noisy)} == {"noisy"}

    def test_one_of_many_tests_may_be_a_little_unlikely(self, calibration):
        """Of nine tests, each may be as unlikely as one in 900 before all together are one in a hundred."""
        first, *others = calibration.quality.verdict.tests
        for p, result in ((0.00112, "passes"), (0.0011, "structure")):
            tests = [replace(first, p_structure=p), *others]
            assert outcome_rows(judged(calibration, tests))[0][6] == result

    def test_a_refused_one_says_its_size_and_the_reason(self, calibration):
        found = words.headline(judged(calibration, usable=False, refused="0.5 mm were asked"))
        assert found == words.Headline("bad", "Good to only 0.80 mm at 2.5 m", "Refused: 0.5 mm were asked.")

    def test_files_of_earlier_versions_and_solves_without_a_verdict_are_not_judged(self, calibration):
        for verdict in (None, replace(calibration.quality.verdict, usable=None, good_to=None)):
            found = words.headline(having(calibration, verdict=verdict))
            assert found.kind == "open" and found.headline == "Not judged"
            assert ("calibrate again" in found.explanation) == (verdict is not None)

    def test_a_solve_that_did_not_converge_is_not_judged_by_its_numbers(self, calibration):
        """Neither by its tests nor by its residuals; and the advice is said once, as the explanation."""
        verdict = replace(calibration.quality.verdict, usable=False, refused="It did not converge.")
        ended = having(calibration, converged=False, verdict=verdict, corner_rms_whitened=9.0)
        assert words.headline(ended) == words.Headline("bad", "Not converged", "It did not converge.")
        assert words.advice(ended) == () and words.bad_views(ended) == []
        assert words.noise_lines(ended)[0] == "Corners: 120, 0.8 % rejected; RMS 0.140 px."
        unsaid = words.headline(having(calibration, converged=False, verdict=None))
        assert unsaid.kind == "bad" and "did not converge" in unsaid.explanation


def test_lengths(calibration):
    along, half, *others = words.lengths(calibration)
    assert along == words.LengthLine("300 mm along the stripe at 2.5 m, laser red", 0.0534)
    assert half.what == "6.15 m between points half a turn apart, laser red"
    assert [line.what.rsplit(" ", 1)[1] for line in others] == ["green", "green"]
    alone = having(calibration, lengths=Lengths(calibration.quality.lasers()[:1]))
    assert words.lengths(alone)[0].what == "300 mm along the stripe at 2.5 m"
    assert words.lengths(having(calibration, lengths=None)) == []


@pytest.mark.parametrize(
    ("ratio", "said"),
    [(0.5, "less noise than promised"), (1.05, "as the corner detector promised"), (3.0, "a model is too simple")],
)
def test_whitened_residuals_in_words(calibration, ratio, said):
    corners, stripes = words.noise_lines(having(calibration, corner_rms_whitened=ratio))
    assert said in corners and f"{ratio:.2f}" in corners
    assert corners.startswith("Corners: 120, 0.8 % rejected; RMS 0.140 px")
    assert stripes.startswith("Stripes: 480, none rejected")


def test_records_without_the_board_and_the_likely_reasons(calibration):
    missed = [Missed(number, "too dark") for number in range(14)] + [Missed(40, "blurred")]
    first, *others = words.board_lines(having(calibration, records=121, missed=tuple(missed)))
    assert first == "Board found in 106 of 121 records."
    assert others == [
        "Not found in records 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 and 2 more: too dark.",
        "Not found in record 40: blurred.",
    ]
    assert words.board_lines(having(calibration, records=None)) == []


def test_second_look(calibration):
    gained = SecondLook(True, views_gained=2, corners_gained=31, stripe_points_gained=-4)
    (line,) = words.second_look(having(calibration, redetected=gained))
    assert line.endswith(": +2 views, +31 corners, -4 stripe points.")
    (line,) = words.second_look(having(calibration, redetected=SecondLook(True, views_gained=0)))
    assert line.endswith(": nothing more.")
    (line,) = words.second_look(having(calibration, redetected=replace(gained, kept=False)))
    assert "was not kept" in line
    assert words.second_look(having(calibration, redetected=None)) == []


class TestBadViews:
    def test_one_whose_kept_corners_are_far_off(self, calibration):
        fit = replace(calibration.fit, corner_error=calibration.fit.corner_error.copy())
        fit.corner_error[4] *= 5
        (found,) = words.bad_views(replace(calibration, fit=fit))
        assert found.record == 104 and "px are usual" in found.why
        assert view_rows(replace(calibration, fit=fit))[0][0] == "104"

    def test_one_outlier_makes_no_bad_view(self, calibration):
        fit = replace(calibration.fit, corner_error=calibration.fit.corner_error.copy())
        # The corner that was rejected.
        fit.corner_error[1, 3] = 40.0
        assert words.bad_views(replace(calibration, fit=fit)) == []

    def test_one_with_many_corners_rejected(self, calibration):
        views = list(calibration.quality.per_view)
        views[2] = replace(views[2], corners_rejected=9)
        (found,) = words.bad_views(having(calibration, per_view=tuple(views)))
        assert found == words.BadView(102, "9 of 20 corners rejected")

    def test_one_left_out_is_named_once(self, calibration):
        fit = replace(calibration.fit, corner_inlier=calibration.fit.corner_inlier.copy())
        fit.corner_inlier[3] = False
        warnings = ("record 103 was left out: far off", "record 1030: something else", "the lamp was on")
        views = list(calibration.quality.per_view)
        views[3] = replace(views[3], dropped=True)
        dropped = having(calibration, per_view=tuple(views), views_dropped=(103,), warnings=warnings)
        dropped = replace(dropped, fit=fit)
        (found,) = words.bad_views(dropped)
        assert found.record == 103 and found.why.startswith("left out")
        assert tuple(words.warnings(dropped)) == warnings[1:]

    def test_records_of_two_captures_may_have_the_same_number(self, calibration):
        """Each row of the table then belongs to the view at its own place."""
        numbers = np.array([0, 1, 2, 0, 1, 2], np.int32)
        corners = replace(calibration.observations.corners, record=numbers)
        observations = replace(calibration.observations, corners=corners)
        per_view = calibration.quality.per_view
        views = [replace(view, record=int(number)) for view, number in zip(per_view, numbers, strict=True)]
        # The third has no usable board, so it is not listed.
        listed = having(calibration, per_view=tuple(views[:2] + views[3:]))
        found = judge_views(listed.quality, listed.fit, observations)
        assert sorted((view.row, view.quality.record) for view in found) == [(0, 0), (1, 1), (3, 0), (4, 1), (5, 2)]


class TestParameters:
    def test_as_many_digits_as_mean_something(self):
        assert Parameter("fx", (1201.23456,), 0.4321, "px").row() == ("fx, px", "1201.23", "0.43")
        assert Parameter("k1", (-0.1,), 0.0, "").row() == ("k1", "-0.100000", "held")
        direction = Parameter("axis", (0.0, -1.0, 0.0), 0.25, "direction")
        assert direction.row() == ("axis", "0.00000 -1.00000 0.00000", "0.25 mrad")

    def test_all_of_a_rig(self, calibration):
        rows = {parameter.name: parameter for parameter in parameters(calibration)}
        assert rows["fx"].value == (1201.25,) and rows["fx"].sigma == pytest.approx(0.4)
        # A plane given with a normal of length 0.99989.
        length = np.linalg.norm([0.99, -0.01, 0.14])
        assert rows["laser red: distance"].value[0] == pytest.approx(200.0 / length)
        # 1e-4 rad in each of two directions.
        assert rows["axis: direction"].sigma == pytest.approx(0.1 * np.sqrt(2))
        assert rows["board bow along y"].value == pytest.approx((-0.2,))
        # Held, and therefore not listed.
        assert not any("bow b" in name for name in rows)

    def test_json_has_units_in_its_keys(self, calibration):
        entries = {parameter.name: parameter.as_json() for parameter in parameters(calibration)}
        assert set(entries["fx"]) == {"name", "value_px", "sigma_px"}
        assert set(entries["k1"]) == {"name", "value", "sigma"}
        assert set(entries["axis: nearest point"]) == {"name", "value_mm", "sigma_mm"}
        assert len(entries["axis: direction"]["direction"]) == 3
        assert entries["axis: direction"]["sigma_mrad"] == pytest.approx(0.1 * np.sqrt(2))


def test_numbers_of_the_solve_that_are_not_there_are_left_out(calibration):
    assert ("corner RMS, px", "0.1400") in quality_rows(calibration)
    assert quality_rows(replace(calibration, quality=Quality())) == []


@pytest.mark.parametrize(
    ("size", "said"),
    [
        (0.0, "0 mm"),
        (0.00997, "0.010 mm"),
        (0.0131, "0.013 mm"),
        (0.997, "1.0 mm"),
        (2.44, "2.4 mm"),
        (123.4, "123 mm"),
    ],
)
def test_sizes_have_two_digits(size, said):
    assert words.millimetres(size) == said


def test_many_pixels_are_written_without_an_exponent():
    assert words.good_to_words(GoodTo(sigma_px=134.9)) == "135 px over the image"
    assert words.good_to_words(GoodTo(sigma_px=0.7544)) == "0.75 px over the image"
    edge = words.good_to_words(GoodTo(sigma_px=0.7544, edge_deg=90.0))
    assert edge == "0.75 px over the image (beyond 90 degrees from the optical axis nothing is judged)"
