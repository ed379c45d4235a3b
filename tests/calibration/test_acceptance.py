"""The quick form of the experiment that compares the sigmas of calibrations with their errors.

Few draws: bounds are as wide as so few allow, at four standard deviations. The figures of the whole run count.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_quick_form_meets_its_targets():
    command = [sys.executable, "-m", "experiments.calibration", "--quick", "--json", "-"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.stdout, run.stderr
    found = json.loads(run.stdout)
    assert found["format"] == "jaxscan-calibration-honesty/1"
    judged = [figure for figure in found["figures"] if figure["low"] is not None or figure["high"] is not None]
    assert len(judged) >= 6
    assert not [figure for figure in judged if not figure["met"]]
    assert run.returncode == 0
