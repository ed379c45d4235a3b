"""The page of a residual of one's own is one program, and its numbers are right."""

import os
import re
import subprocess
import sys

import pytest

from tests.documentation.pages import ROOT, fences


pytestmark = pytest.mark.more


NUMBER = re.compile(r"\d+\.\d+")
EVERY = fences(ROOT / "docs" / "least-squares.md")


def test_it_prints_what_the_page_says():
    program = "\n".join(fence.text for fence in EVERY if fence.language == "python")
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=os.environ)
    assert run.returncode == 0, run.stderr
    said = "".join(fence.text for fence in EVERY if not fence.language)
    assert NUMBER.sub("0", run.stdout) == NUMBER.sub("0", said)
    scale, sigma, leverage = map(float, NUMBER.findall(run.stdout))
    # The true factor; and nothing else knows it, so the tape has all of its residual.
    assert abs(scale - 1.004) < 3 * sigma < 2e-3
    assert leverage > 0.99
