"""One step: the notes of a step that was done, and what a person gave that its sweeps contradict."""

import pytest

from jaxscan.errors import CalibrationError, GivenError
from jaxscan.project import work as module
from tests.opened import edit, work


def test_notes_end_where_they_end(museum, monkeypatch):
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud"]')
    monkeypatch.setitem(
        module.WORK, "cloud", lambda workspace: _say(workspace, "the first note", "The second.", "is this one?")
    )
    rows = work(museum)
    assert {row.message for row in rows} == {"the first note. The second. is this one?"}


def _say(workspace, *notes):
    workspace.notes.extend(notes)
    for number in range(len(workspace.step.outputs)):
        workspace.target(number).write_bytes(b"made")


class Stopped(Exception):
    """The stored calibration was about to be used."""


@pytest.mark.parametrize(("problem", "raised"), [(GivenError("length 1"), GivenError), (CalibrationError(""), Stopped)])
def test_a_contradiction_of_what_was_given_is_not_hidden_by_the_stored_calibration(monkeypatch, problem, raised):
    def fail(workspace):
        raise problem

    def save(workspace, calibration, refused):
        raise Stopped

    monkeypatch.setattr(module, "_recalibrated", fail)
    monkeypatch.setattr(module, "_save", save)
    with pytest.raises(raised):
        module.refine_rig(object.__new__(module.StepWorkspace))
