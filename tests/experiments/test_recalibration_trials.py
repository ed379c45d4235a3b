"""The arithmetic of the trials' limits, on figures made by hand."""

import numpy as np
import pytest

from experiments.recalibration import trials
from experiments.recalibration.kinds import KINDS
from experiments.recalibration.trials import LIMITS, TRIALS, Limit, page, rows


def trial(before, after, sigma, **more):
    """A trial with two lengths across half a turn [mm]."""
    half = [
        {"name": "half a turn", "metres": m, "before": b, "after": a, "sigma_before": 1.0, "sigma_after": s}
        for m, b, a, s in zip((4.0, 6.0), before, after, sigma, strict=True)
    ]
    return {"lengths": half, "updated": True, "seconds": 1.0, "peak_mb": 100.0, **more}


TWO = [trial((3.0, 4.0), (0.3, 0.1), (0.1, 0.1)), trial((-3.0, 4.0), (0.1, -0.3), (0.2, 0.2))]


def test_factors_and_ratios():
    assert trials.better(TWO) == pytest.approx(3.0 / np.sqrt(0.05))
    assert trials.spread(1)(TWO) == pytest.approx(np.sqrt(0.05))
    assert trials.honest(0)(TWO) == pytest.approx(np.sqrt((9 + 0.25) / 2))
    assert trials.away(TWO) == pytest.approx(-14.5)


def test_a_length_that_moves_away_counts_in_stated_sigmas():
    assert trials.away([*TWO, trial((0.1, 1.0), (-0.4, 0.0), (0.1, 0.1))]) == pytest.approx(3.0)


def test_lost_steps_must_be_found_where_they_are():
    found = {"jumps": [[0, 101, np.deg2rad(-1.75)]], "sentences": ["a step was lost"]}
    at = {"lost": [100, -1.8]}
    assert trials.jumps([{"table": found, **at}]) == 1.0
    for wrong in ({"jumps": []}, {"jumps": [[0, 110, np.deg2rad(-1.8)]]}, {"jumps": 2 * found["jumps"]}):
        assert trials.jumps([{"table": found | wrong, **at}]) == 0.0


def test_what_is_missing_or_failed_is_no_success():
    limit = Limit("good", "better", trials.better, low=2)
    for own, word in (
        ([], "not run"),
        ([{"problem": "no plane"}], "no result"),
        ([*TWO, {"problem": ""}], "**no**"),
    ):
        found, missed = rows((limit,), {"good": own})
        assert missed == 1 and word in " ".join(found[0])
    found, missed = rows((limit,), {"good": TWO})
    assert missed == 0 and found[0][-1] == "yes"


def test_every_limit_has_its_trials():
    assert {limit.kind for limit in LIMITS} <= set(TRIALS)
    assert set(KINDS) <= set(TRIALS)
    text, missed = page({kind: [] for kind in TRIALS})
    assert missed == len(LIMITS) and "not run" in text
