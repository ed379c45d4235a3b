"""What pages tell people to type: commands that the command line knows, and files that can be read."""

import ast
import json
import re
import shlex
import textwrap
import tomllib

import pytest

from jaxscan.cli.verbs import parse
from tests.documentation.pages import ROOT, fences, name_of, pages


EVERY = [fence for page in pages() for fence in fences(page)]
COMMANDS = [
    (f"{name_of(fence.page)}:{fence.line + number}", line.strip().removeprefix("$ "))
    for fence in EVERY
    for number, line in enumerate(fence.text.splitlines(), 1)
    if line.strip().removeprefix("$ ").startswith(("jaxscan ", "make ", "make\n")) and not fence.language
]


def test_pages_have_commands():
    """So that none of the tests below is about nothing."""
    assert {"README.md", "docs/own-rig.md", "docs/commands.md"} <= {where.split(":")[0] for where, _ in COMMANDS}
    assert len(COMMANDS) > 60


@pytest.mark.parametrize(("where", "command"), COMMANDS, ids=[where for where, _ in COMMANDS])
def test_commands_are_those_of_the_command_line(where, command, capsys):
    program, *words = shlex.split(command, comments=True)
    if program == "make":
        targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
        if name_of(ROOT / where.split(":")[0]) == "hardware/firmware/README.md":
            targets |= set(re.findall(r"^([a-z-]+):", (ROOT / "hardware/firmware/Makefile").read_text(), re.MULTILINE))
        assert {word for word in words if "=" not in word and not word.startswith("-")} <= targets, where
        return
    try:
        parse(words)
    except SystemExit:
        pytest.fail(f"{where}: {command}\n{capsys.readouterr().err}")


def test_a_command_that_nobody_knows_is_noticed(capsys):
    for words in (["scan", "scan.toml"], ["plan", "room.ply", "--colour", "x"], ["mash", "room.ply"]):
        with pytest.raises(SystemExit):
            parse(words)
    capsys.readouterr()


@pytest.mark.parametrize(
    "fence",
    [fence for fence in EVERY if fence.language in ("python", "toml", "json")],
    ids=lambda fence: f"{name_of(fence.page)}:{fence.line}",
)
def test_files_and_programs_can_be_read(fence):
    text = textwrap.dedent(fence.text)
    {"python": ast.parse, "toml": tomllib.loads, "json": json.loads}[fence.language](text)


def test_configurations_that_pages_name_are_there():
    named = {name for page in pages() for name in re.findall(r"\bconfigs/(\w+\.toml)", page.read_text())}
    assert named and named <= {path.name for path in (ROOT / "configs").iterdir()}
