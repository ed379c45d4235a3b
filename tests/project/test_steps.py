"""Projects: what their files may say, what their patterns find, and the graph of what is to be made."""

import shutil

import pytest

from jaxscan.errors import ConfigError
from jaxscan.files.capture import HEADER_NAME
from jaxscan.project import digest_of, digests_of, load_project, parts_of, project_text, steps_of


TEXT = """
[project]
name = "museum"
products = ["cloud", "mesh", "plan"]
formats = ["ply", "e57"]

[[rig]]
name = "one"
boards = ["boards"]

[[captures]]
pattern = "room-*"
rig = "one"
settings = { every = 2 }
"""


@pytest.fixture
def folder(tiny, tmp_path):
    """A project of two sweeps, and a folder that is none."""
    shutil.copytree(tiny.boards, tmp_path / "boards")
    for name in ("room-2", "room-1"):
        shutil.copytree(tiny.sweep, tmp_path / name)
    (tmp_path / "room-notes").mkdir()
    (tmp_path / "project.toml").write_text(TEXT)
    return tmp_path


def changed(folder, *pairs):
    text = TEXT
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    (folder / "project.toml").write_text(text)
    return folder / "project.toml"


def test_captures_are_found(folder):
    project = load_project(folder / "project.toml")
    assert [one.name for one in project.captures] == ["room-1", "room-2"]
    assert project.captures[0].settings.every == 2 and project.output == folder / "products"


def test_steps_come_after_what_they_need(folder):
    steps = steps_of(load_project(folder / "project.toml"))
    assert [step.key for step in steps] == [
        "calibration/one",
        *(f"{kind}/room-{number}" for number in (1, 2) for kind in ("cloud", "mesh", "plan")),
    ]
    seen = set()
    for step in steps:
        assert seen.issuperset(step.inputs)
        seen.add(step.key)
    outputs = [output for step in steps for output in step.outputs]
    assert len(set(outputs)) == len(outputs) and "clouds/room-1.e57" in outputs


def test_a_digest_changes_with_whatever_changes_the_product(folder):
    steps = {step.key: step for step in steps_of(load_project(folder / "project.toml"))}
    step = steps["cloud/room-1"]
    digests = dict.fromkeys((*step.inputs, *step.sources.values()), "sha256:1")

    def digest(step=step, digests=digests, code="code"):
        return digest_of(step, parts_of(step, digests, code))

    first = digest()
    assert first == digest(digests=dict(reversed(digests.items())))
    # A project that was moved is the same.
    moved = {"capture": "/elsewhere/room-1"}
    assert first == digest(step._replace(sources=moved), digests | {"/elsewhere/room-1": "sha256:1"})
    others = [
        digest(digests=digests | {step.sources["capture"]: "sha256:2"}),
        digest(digests=digests | {step.inputs[0]: "sha256:2"}),
        digest(code="better code"),
        digest(step._replace(settings={"every": 1})),
        digest(step._replace(outputs=step.outputs[:1])),
    ]
    assert len({first, *others}) == 6


@pytest.mark.parametrize(
    "pair, says",
    [
        (('pattern = "room-*"', 'pattern = "hall-*"'), 'the pattern "hall-*" finds no capture.'),
        (('pattern = "room-*"', 'pattern = "room-notes"'), 'the pattern "room-notes" finds no capture.'),
        (('rig = "one"', 'rig = "two"'), 'captures name the rig "two", known are one'),
        (('boards = ["boards"]', ""), "needs a calibration or captures of boards"),
        (('"mesh"', '"meshes"'), "meshes"),
        (("every = 2", "evry = 2"), "every"),
        (("every = 2", "max_range_m = 0.01"), "found min_range_m 0.05 and max_range_m 0.01"),
        (('name = "museum"', 'name = "../museum"'), "name"),
        (('boards = ["boards"]', 'boards = ["boards"]\nfirst = 2026-02-01\nlast = 2026-01-01'), "before it begins"),
    ],
)
def test_what_cannot_be_meant_is_one_line(folder, pair, says):
    with pytest.raises(ConfigError) as refused:
        load_project(changed(folder, pair))
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_a_capture_that_two_patterns_find(folder):
    path = changed(folder)
    path.write_text(TEXT + '[[captures]]\npattern = "*-1"\nrig = "one"\n')
    with pytest.raises(ConfigError, match='"room-1" is found twice'):
        load_project(path)


def test_names_are_of_what_the_pattern_leaves_open(folder):
    for room in ("saal 1", "Küche"):
        shutil.copytree(folder / "room-1", folder / "rooms" / room / "sweep")
    path = changed(folder, ('pattern = "room-*"', 'pattern = "rooms/*/sweep"'))
    assert [one.name for one in load_project(path).captures] == ["Kuche", "saal-1"]
    path = changed(folder, ('pattern = "room-*"', 'pattern = "*/*/sw*"'))
    assert [one.name for one in load_project(path).captures] == ["rooms-Kuche-sweep", "rooms-saal-1-sweep"]
    path = changed(folder, ('pattern = "room-*"', 'pattern = "rooms/Küche/sweep"'))
    assert [one.name for one in load_project(path).captures] == ["sweep"]


def test_boards_of_a_rig_are_no_sweeps(folder):
    path = changed(folder, ('pattern = "room-*"', 'pattern = "*"'))
    assert [one.name for one in load_project(path).captures] == ["room-1", "room-2"]


def test_a_capture_that_cannot_be_read_stops_no_other(folder):
    whole = digests_of(steps_of(load_project(folder / "project.toml")))[0]
    (folder / "room-1" / "frames.jsonl").unlink()
    digests, _ = digests_of(steps_of(load_project(folder / "project.toml")))
    assert {key for key in digests if digests[key] != whole[key]} == {"cloud/room-1", "mesh/room-1", "plan/room-1"}


def test_a_group_that_is_called_as_a_capture(folder):
    group = '[[group]]\nname = "room-1"\ncaptures = ["room-1", "room-2"]\nmerged = ["plan"]\n'
    (folder / "project.toml").write_text(TEXT + group)
    keys = [step.key for step in steps_of(load_project(folder / "project.toml"))]
    assert {"plan/room-1", "merged/plan/room-1"} <= set(keys) and len(keys) == len(set(keys))
    # Two calibrations of one name.
    rigs = '[[rig]]\nname = "one-2026-01-01"\nboards = ["boards"]\n'
    times = ('boards = ["boards"]', f'boards = ["boards"]\nfirst = 2026-01-01\n\n{rigs}')
    path = changed(folder, times)
    path.write_text(path.read_text() + '[[captures]]\npattern = "room-2"\nrig = "one-2026-01-01"\n')
    edit = path.read_text().replace('pattern = "room-*"', 'pattern = "room-1"')
    path.write_text(edit)
    dated(folder / "room-1", "2026-03-01")
    with pytest.raises(ConfigError, match="two steps would be calibration/one-2026-01-01"):
        steps_of(load_project(path))


def test_patterns_of_a_new_project_find_what_is_added_later(folder):
    (folder / "project.toml").unlink()
    for room in ("saal-1", "saal-2"):
        shutil.copytree(folder / "room-1", folder / "rooms" / room / "sweep")
    text = project_text(folder)
    assert [line for line in text.splitlines() if line.startswith("pattern")] == [
        'pattern = "room-*"',
        'pattern = "rooms/*/sweep"',
    ]
    (folder / "project.toml").write_text(text)
    assert [one.name for one in load_project(folder / "project.toml").captures] == [
        "room-1",
        "room-2",
        "saal-1",
        "saal-2",
    ]


def dated(folder, day):
    """The day on which a capture was begun, written into its header."""
    path = folder / HEADER_NAME
    text = "\n".join(line for line in path.read_text().splitlines() if not line.startswith("started"))
    table = "[acquisition]" if "[acquisition]" in text else ""
    began = f'[acquisition]\nstarted = "{day}T10:00:00+00:00"\n'
    path.write_text(text.replace(table, began) if table else f"{text}\n{began}")


def test_the_calibration_of_the_day(folder):
    for name, day in (("room-1", "2026-01-10"), ("room-2", "2026-03-01")):
        dated(folder / name, day)
    later = '[[rig]]\nname = "one"\ncalibration = "later.json"\nfirst = 2026-02-02'
    times = f'boards = ["boards"]\nlast = 2026-02-01\n\n{later}'
    project = load_project(changed(folder, ('boards = ["boards"]', times)))
    assert [one.rig.calibration for one in project.captures] == [None, "later.json"]
    steps = {step.key: step for step in steps_of(project)}
    assert steps["cloud/room-1"].inputs == ("calibration/one",)
    assert steps["cloud/room-2"].sources["calibration"] == str(folder / "later.json")
    path = changed(folder, ('boards = ["boards"]', times.replace("first = 2026-02-02", "first = 2026-01-02")))
    with pytest.raises(ConfigError, match="2 calibrations fit room-1 of 2026-01-10"):
        load_project(path)
