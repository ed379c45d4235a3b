"""The words of a step that was done: every note a sentence."""

import json

from jaxscan.project import work as doing
from tests.opened import edit, work


def test_notes_end_where_they_end(museum, monkeypatch):
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud"]')
    monkeypatch.setitem(
        doing.WORK, "cloud", lambda workspace: _say(workspace, "the first note", "The second.", "is this one?")
    )
    rows = work(museum)
    assert {row.message for row in rows} == {"the first note. The second. is this one?"}, json.dumps(str(rows))


def _say(workspace, *notes):
    workspace.notes.extend(notes)
    for number in range(len(workspace.step.outputs)):
        workspace.target(number).write_bytes(b"made")
