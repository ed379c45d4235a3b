"""One step: the notes of a step that was done, and what a person gave that its sweeps contradict."""

import re

import pytest

from jaxscan.errors import CalibrationError, GivenError
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME
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


def test_a_plan_has_the_names_of_project_and_room_and_the_day_of_the_capture(museum, monkeypatch):
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud", "plan"]')
    for number, day in ((1, '"2026-03-05T10:00:00+01:00"'), (2, "7")):
        header = museum.parent / f"room-{number}" / HEADER_NAME
        text = re.sub("(?m)^started = .*$", "", header.read_text())
        header.write_text(text.replace("[acquisition]", f"[acquisition]\nstarted = {day}"))
        # A seal keeps the header as it was.
        edit(header.with_name(JOURNAL_NAME), '"journal_sha256"', '"other"')
    sheets = []
    monkeypatch.setitem(module.WORK, "cloud", lambda workspace: _say(workspace, "made"))
    for name in ("cloud", "scanner"):
        monkeypatch.setattr(module.StepWorkspace, name, lambda workspace: None)
    monkeypatch.setattr(module, "survey_room", lambda cloud, *, scanner: None)
    monkeypatch.setattr(module, "draw_plan", lambda survey, *, sheet: sheets.append(sheet))
    monkeypatch.setattr(module.api, "save_drawing", lambda drawing, path: path.write_bytes(b"made"))
    rows = work(museum)
    assert not [row.message for row in rows if row.state == "failed"]
    titles = {(sheet.project, sheet.room, sheet.date) for sheet in sheets}
    assert titles == {("museum", "room-1", "2026-03-05"), ("museum", "room-2", "")}
