"""The calibration report: complete, without external parts, and safe with hostile text in files."""

import base64
import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from jaxscan.calibration import Quality, Verdict
from jaxscan.calibration.result import Direction
from jaxscan.geometry import Chessboard
from jaxscan.report import calibration_date, calibration_page, thumbnail


VOID = {"meta", "br", "img", "hr", "link", "input", "source"}
SECTIONS = [
    "In words",
    "The rig",
    "Tests of the models",
    "Parameters",
    "Uncertainty against distance",
    "Residuals over the image",
    "Stripe and table",
    "Are the residuals noise?",
    "Views, worst first",
    "Correlations",
    "Combinations that the data do not determine",
    "Numbers of the solve",
]


class Document(HTMLParser):
    """A page taken apart; refuses elements that are not closed in order, and names used twice."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.attributes, self.words = [], [], [], {}
        self.ids = set()
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, key, value) for key, value in attributes]
        for key, value in attributes:
            if key == "id":
                assert value not in self.ids
                self.ids.add(value)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.setdefault(self.open[-1] if self.open else "", []).append(data.strip())

    def all_words(self):
        return " ".join(word for words in self.words.values() for word in words)


@pytest.fixture(scope="module")
def text(calibration):
    return calibration_page(calibration)


@pytest.fixture(scope="module")
def document(text):
    return Document(text)


def assert_alone(text, document):
    """Nothing is fetched, nothing runs."""
    assert "http" not in text.replace("http-equiv", "")
    assert "//" not in re.sub(r'"data:image/png;base64,[^"]*"', "", text).replace("sha256://", "")
    assert not {"script", "iframe", "object", "embed", "link", "base", "form", "img"} & set(document.tags)
    for tag, key, value in document.attributes:
        assert not key.startswith("on"), (tag, key)
        if key.endswith("href") or key == "src":
            assert value.startswith(("#", "data:image/png;base64,")), (tag, key, value[:40])
        if "url(" in (value or ""):
            assert re.findall(r"url\((.)", value) == ["#"] * value.count("url(")
    assert ("meta", "content", "default-src 'none'; img-src data:; style-src 'unsafe-inline'") in document.attributes


def test_every_section_is_there_in_order(document):
    assert document.words["h2"] == SECTIONS


def test_it_stands_alone(text, document):
    assert_alone(text, document)
    # Each reference inside leads somewhere.
    for _, key, value in document.attributes:
        if key.endswith("href") and value.startswith("#"):
            assert value[1:] in document.ids


def test_the_verdict_comes_first_and_in_millimetres(document):
    words = document.all_words()
    assert document.words["strong"] == ["Good to 0.80 mm at 2.5 m"]
    assert "± 0.053 mm" in document.words["b"] and "± 1.6 mm" in document.words["b"]
    assert "300 mm along the stripe at 2.5 m, laser red" in words
    assert "6.15 m between points half a turn apart, laser green" in words
    assert "Capture the board in the corners of the image." in words


def test_figures_have_text_and_every_view_its_panel(document):
    assert document.tags.count("svg") == 1 + 2 + 3 + 4 + 1 + 1 + 1 + 6 + 1
    assert sum(tag == "svg" and key == "aria-label" for tag, key, _ in document.attributes) == document.tags.count(
        "svg"
    )
    for label in ("image row, px", "table angle, degrees", "depth, m", "c2 − s1", "axis.p1"):
        assert label in document.words["text"] + document.words.get("tspan", []), label


def having(calibration, **quality):
    return dataclasses.replace(calibration, quality=dataclasses.replace(calibration.quality, **quality))


def test_refused_calibrations_say_why(made):
    good = made()
    tests = list(good.quality.verdict.tests)
    tests[5] = dataclasses.replace(tests[5], p_structure=1e-9, effect_mm=0.75, effect_px=0.02)
    verdict = dataclasses.replace(good.quality.verdict, usable=False, refused="0.5 mm were asked", tests=tuple(tests))
    page = Document(calibration_page(dataclasses.replace(having(good, verdict=verdict), fit=None)))
    assert page.words["strong"] == ["Good to only 0.80 mm at 2.5 m"]
    because = "0.75 mm of that because the light sheet does not have the shape of its model"
    assert f"Refused: 0.5 mm were asked; {because}." in page.all_words()
    assert "0.75 mm, 0.02 px" in page.words["td"]
    assert ("tr", "class", "worse") in page.attributes


def test_nothing_is_concluded_from_a_solve_that_did_not_converge(calibration):
    """Whatever else stands in the file."""
    verdict = Verdict(False, refused="The solve did not converge in 1 step.")
    page = Document(calibration_page(having(calibration, converged=False, verdict=verdict)))
    assert page.words["strong"] == ["Not converged"]
    shown = ["In words", "Residuals over the image", "Stripe and table", "Views, worst first", "Numbers of the solve"]
    assert page.words["h2"] == shown
    words = page.all_words()
    assert words.count("The solve did not converge in 1 step.") == 1
    for diagnosis in ("Next captures", "the promise is too low", "Records that stand out", "±"):
        assert diagnosis not in words


def test_records_lead_to_their_views(document):
    links = [value for tag, key, value in document.attributes if tag == "a" and key == "href"]
    assert sorted(links) == sorted(f"#panel-{row}" for row in range(6))
    assert {f"panel-{row}" for row in range(6)} <= document.ids


def test_the_rig_is_named_with_its_lengths(calibration, document):
    foot = calibration.scanner.turntable
    axis = np.cross(np.asarray(foot.direction, float), np.asarray(foot.point, float))
    cells = document.words["td"]
    assert f"{1e3 * np.linalg.norm(axis):.1f} mm" in cells
    for number, name in enumerate(("red", "green")):
        length = f"{1e3 * abs(float(calibration.scanner.laser(number).distance)):.1f} mm"
        assert cells[cells.index(f"camera to sheet {name}") + 1] == length


def test_negative_numbers_have_a_minus_sign(document):
    numbers = document.words["td"] + document.words["text"] + document.words.get("tspan", [])
    assert not [text for text in numbers if re.match(r"-[0-9.]", text)]
    assert any(text.startswith("−") for text in document.words["td"])


@pytest.mark.parametrize(
    ("said", "shown"),
    [("2026-03-01T14:05:00+00:00", "1 March 2026, 14:05 UTC"), ("soon", ""), (7, ""), ("9" * 5000, "")],
)
def test_the_date_is_that_of_the_calibration(calibration, said, shown):
    assert calibration_date(dataclasses.replace(calibration, provenance={"date": said})) == shown


def test_the_date_and_photographs_are_on_the_page(calibration, monkeypatch):
    for module in ("page", "drawing"):
        monkeypatch.setattr(f"jaxscan.report.{module}.as_svg", lambda figure, name, description: "")
    jpeg = thumbnail(np.full((1024, 1280), 90, np.uint8), "mono8")
    assert len(jpeg) < 30_000
    page = Document(calibration_page(calibration, date="1 March 2026", photographs={101: jpeg, 7: jpeg}))
    assert "1 March 2026" in page.all_words()
    (source,) = [value for tag, key, value in page.attributes if tag == "img" and key == "src"]
    assert base64.b64decode(source.removeprefix("data:image/jpeg;base64,")) == jpeg
    assert ("img", "alt", "Photograph of record 101") in page.attributes


HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)> $\\frac{x}$ &amp; \x00 \u202e 💥'


def test_names_and_texts_of_strangers_stay_text(made):
    hostile = made(laser_names=(HOSTILE[:64], "</text></svg><script>"))
    good = hostile.quality.verdict
    tests = (dataclasses.replace(good.tests[0], name=HOSTILE), *good.tests[1:])
    hostile = having(
        hostile,
        warnings=(HOSTILE,),
        verdict=dataclasses.replace(good, tests=tests, advice=(HOSTILE,)),
        spectrum=(Direction(0.97, {HOSTILE: 1.0}),),
    )
    hostile.provenance["captures"] = [{"name": HOSTILE, "digest": HOSTILE}]
    hostile.provenance["versions"] = {HOSTILE: HOSTILE}
    text = calibration_page(hostile, notes=(HOSTILE,))
    page = Document(text)
    assert_alone(text, page)
    assert "\x00" not in text and "\u202e" not in text
    # It is shown as it was written, and not left out.
    assert "<script>alert(1)</script><img src=x onerror=alert(2)>" in page.all_words()


@pytest.mark.parametrize("known", [{}, {"corners": 1}])
def test_what_is_missing_is_left_out(calibration, known):
    # Drawn once, where there is most to draw; figures take time.
    fit = calibration.fit if known else None
    page = Document(calibration_page(dataclasses.replace(calibration, quality=Quality(**known), fit=fit)))
    assert page.words["strong"] == ["Not judged"]
    assert ("Residuals over the image" in page.words["h2"]) == (fit is not None)
    for title in ("Tests of the models", "Uncertainty against distance"):
        assert title not in page.words["h2"]


def test_a_file_without_observations(calibration):
    page = Document(calibration_page(dataclasses.replace(calibration, fit=None, observations=None)))
    drawn = {"Residuals over the image", "Stripe and table", "Are the residuals noise?"}
    assert page.words["h2"] == [title for title in SECTIONS if title not in drawn]


def test_a_camera_alone(calibration):
    order = calibration.camera.parameter_names()
    stripes = [f"stripe_{name}" for name in ("error", "sigma", "leverage", "inlier")]
    fit = dataclasses.replace(calibration.fit, **{name: getattr(calibration.fit, name)[:0] for name in stripes})
    alone = dataclasses.replace(
        calibration, scanner=None, order=order, covariance=calibration.covariance[:9, :9], fit=fit
    )
    page = Document(calibration_page(alone))
    assert "camera alone, without laser and turntable" in page.all_words()
    assert "Stripe and table" not in page.words["h2"]
    assert "Uncertainty against distance" not in page.words["h2"]


def test_a_camera_of_which_nothing_is_known(calibration):
    """No covariance at all: written by hand, or from elsewhere."""
    bare = dataclasses.replace(
        calibration, order=(), covariance=calibration.covariance[:0, :0], quality=Quality(), fit=None
    )
    page = Document(calibration_page(bare))
    assert "Correlations" not in page.words["h2"]
    assert "held" in page.words["td"]


@pytest.mark.slow
def test_a_large_one_is_small_enough(made):
    """40 views of 88 corners with a thousand stripe points each: under 3 MB."""
    text = calibration_page(made(views=40, points=1000, laser_names=("red",), board=Chessboard(11, 8, 0.04)))
    assert len(text.encode()) < 3_000_000
    Document(text)
