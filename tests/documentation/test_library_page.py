"""The page whose blocks are one program: it runs as it stands, prints what the page says, and its numbers are right."""

import os
import re
import subprocess
import sys

import pytest

from tests.documentation.pages import ROOT, fences


pytestmark = pytest.mark.more


NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?")
EVERY = fences(ROOT / "docs" / "library.md")


@pytest.fixture(scope="module")
def printed():
    program = "\n".join(fence.text for fence in EVERY if fence.language == "python")
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=os.environ)
    assert run.returncode == 0, run.stderr
    return run.stdout


def numbers_behind(words, text):
    found = re.findall(re.escape(words) + rf" ({NUMBER.pattern})", text)
    assert found, f"{words} is not in: {text}"
    return float(found[-1])


def test_it_prints_what_the_page_says(printed):
    said = "".join(fence.text for fence in EVERY if not fence.language)
    assert NUMBER.sub("0", printed) == NUMBER.sub("0", said)
    # The last digits depend on the machine.
    for there, here in zip(NUMBER.findall(said), NUMBER.findall(printed), strict=True):
        digits = len(there.partition(".")[2])
        assert float(here) == pytest.approx(float(there), rel=5e-3, abs=3 * 10.0**-digits)


def test_monte_carlo_and_propagation_agree(printed):
    propagated, drawn = numbers_behind("propagated", printed), numbers_behind("Monte Carlo", printed)
    # The draws have the covariance exactly: chance plays no part.
    assert drawn == pytest.approx(propagated, rel=0.01)


def test_the_length_errs_by_its_sigma(printed):
    assert abs(numbers_behind("error", printed)) < 3 * numbers_behind("sigma", printed)
    assert abs(numbers_behind("true rig", printed)) < 0.15
