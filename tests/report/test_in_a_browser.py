"""Reports in a real browser: nothing is wider than the window, on a desk and on a telephone."""

import pytest

from jaxscan.report import Beside, calibration_page, cloud_page, facts_of
from jaxscan.report.recalibration import recalibration_page

from ..browser.driver import NARROW, Looks
from ..browser.driver import browser as browser
from .made_recalibration import make_recalibration


LONG = "a" * 200


@pytest.mark.parametrize("size", [(1400, 900), NARROW], ids=["desk", "telephone"])
@pytest.mark.parametrize("kind", ["calibration", "cloud", "recalibration"])
def test_no_report_scrolls_sideways(browser, tmp_path, calibration, cloud, box, kind, size):
    pages = {
        "calibration": lambda: calibration_page(calibration, notes=(LONG,)),
        "cloud": lambda: cloud_page(facts_of(cloud, box), box, Beside(name=LONG, notes=(LONG,))),
        "recalibration": lambda: recalibration_page(
            make_recalibration(calibration.scanner, stations=2), title=LONG, notes=(LONG,)
        ),
    }
    (tmp_path / "report.html").write_text(pages[kind]())
    looks = Looks(browser)
    looks.open((tmp_path / "report.html").as_uri(), size)
    assert "±" in browser.page_source and looks.too_wide() <= 0
