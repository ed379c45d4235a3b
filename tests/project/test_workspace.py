"""The workspace of a step: what it fetches from storage."""

import fsspec
import pytest

from jaxscan.files.capture import open_capture
from jaxscan.project.steps import Step
from jaxscan.project.work import workspace_of


@pytest.fixture
def storage():
    storage = fsspec.filesystem("memory")
    yield storage
    storage.rm("/desk", recursive=True)


def step(sources):
    return Step("calibration/rig", "calibration", (), sources, {}, (), {})


def test_two_captures_of_one_name_are_fetched_beside_each_other(tiny, storage, tmp_path):
    for above in ("a", "b"):
        storage.put(f"{tiny.sweep}/", f"/desk/{above}/boards", recursive=True)
    storage.pipe("/desk/b/boards/notes.txt", b"the second")
    sources = {"boards 1": "memory://desk/a/boards", "boards 2": "memory://desk/b/boards"}
    with workspace_of(step(sources), tmp_path, lambda done, of: None) as workspace:
        first, second = (workspace.capture(role) for role in sources)
        assert first.records == second.records == open_capture(tiny.sweep).records
        paths = [path.parent for path in workspace.folder.rglob("capture.toml")]
        assert sorted(path.name for path in paths) == ["boards", "boards"]
        assert sum((path / "notes.txt").exists() for path in paths) == 1


def test_two_files_of_one_name_are_fetched_beside_each_other(storage, tmp_path):
    sources = {}
    for above in ("a", "b"):
        storage.pipe(f"/desk/{above}/scanner.toml", above.encode())
        sources[above] = f"memory://desk/{above}/scanner.toml"
    with workspace_of(step(sources), tmp_path, lambda done, of: None) as workspace:
        # The second time it is there.
        for _ in range(2):
            assert {role: workspace.file(role).read_text() for role in sources} == {"a": "a", "b": "b"}
