"""What a person gave for a group and what its sweeps contradict."""

import pytest

from jaxscan.errors import CalibrationError, GivenError
from jaxscan.project import work


class Stopped(Exception):
    """The stored calibration was about to be used."""


@pytest.mark.parametrize(("problem", "raised"), [(GivenError("length 1"), GivenError), (CalibrationError(""), Stopped)])
def test_a_contradiction_of_what_was_given_is_not_hidden_by_the_stored_calibration(monkeypatch, problem, raised):
    def fail(workspace):
        raise problem

    def save(workspace, calibration, refused):
        raise Stopped

    monkeypatch.setattr(work, "_recalibrated", fail)
    monkeypatch.setattr(work, "_save", save)
    with pytest.raises(raised):
        work.refine_rig(object.__new__(work.StepWorkspace))
