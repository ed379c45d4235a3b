"""Rooms that show what is in them: sizes of folders, files and signatures, and a facade in every room."""

import ast
import subprocess
from pathlib import Path

from tests.every_file import for_every, tree_of


ROOT = Path(__file__).resolve().parent.parent
HOUSES = ("jaxscan", "hardware", "experiments")
MOST_FILES, MOST_LINES, MOST_PARAMETERS = 15, 300, 6
SOURCES = (".py", ".c", ".h")


def tracked():
    """Source files of the project that git knows, or all where there is no git."""
    try:
        run = subprocess.run(["git", "ls-files", *HOUSES], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return [path for house in HOUSES for path in (ROOT / house).rglob("*") if path.suffix in SOURCES]
    paths = [ROOT / line for line in run.stdout.splitlines()]
    return [path for path in paths if path.suffix in SOURCES and path.exists()]


FILES = tracked()
PYTHON = [path for path in FILES if path.suffix == ".py"]
FOLDERS = sorted({path.parent for path in FILES})
SETTINGS = {"__init__"}
"""Constructors of settings may have as many parameters as there are settings; others are listed below."""


def name_of(path):
    return str(path.relative_to(ROOT))


def verbs(tree):
    """Functions of the command line: every parameter of theirs is an option."""
    return {
        node.name
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and (ast.get_docstring(node) or "").strip()
        and not node.name.startswith("_")
    }


@for_every(FOLDERS, name_of)
def test_no_folder_is_crowded(folder):
    files = [path.name for path in FILES if path.parent == folder]
    assert len(files) <= MOST_FILES, f"{len(files)} files"


@for_every(PYTHON, name_of)
def test_no_file_is_long(path):
    lines = len(path.read_text().splitlines())
    assert lines <= MOST_LINES, f"{lines} lines"


@for_every(PYTHON, name_of)
def test_no_signature_is_long(path):
    tree = tree_of(path)
    options = verbs(tree) if "cli" in path.parts else set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or node.name in options:
            continue
        arguments = node.args
        names = [one.arg for one in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
        names = names[1:] if names[:1] in (["self"], ["cls"]) else names
        assert len(names) <= MOST_PARAMETERS, f"line {node.lineno}: {node.name} has {len(names)} parameters"


@for_every([f for f in FOLDERS if f.parts[-1] != "data" and "jaxscan" in f.parts], name_of)
def test_every_room_has_a_facade(folder):
    """A room's `__init__.py` re-exports what others may use of it."""
    tree = tree_of(folder / "__init__.py")
    assert ast.get_docstring(tree), "no docstring"
    assert len(tree.body) > 1 or folder.name == "cli" or folder.parent.name == "cli", "exports nothing"
