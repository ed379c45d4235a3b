"""Configuration errors: one line with the file, the key, the value found and the values allowed."""

import subprocess
import sys
import time
from typing import Annotated, Literal

import pydantic
import pytest

from jaxscan.errors import ConfigError
from jaxscan.files.disk import FileModel, Integer, Number, load_toml, parse_json
from jaxscan.files.disk.config import MAX_CONFIG_BYTES, MAX_PARTS, parse_toml
from jaxscan.files.disk.reading import MAX_DEPTH

from .conftest import refused


class Round(FileModel):
    type: Literal["round"]
    radius: Annotated[Number, pydantic.Field(gt=0)]


class Square(FileModel):
    type: Literal["square"]
    side: Number


class Part(FileModel):
    name: str
    shape: Annotated[Round | Square, pydantic.Field(discriminator="type")]


class Config(FileModel):
    width: Integer = 10
    mode: Literal["fast", "fine"] = "fast"
    parts: tuple[Part, ...] = ()
    extra: Part | None = None


@pytest.fixture
def load(tmp_path):
    def load(text):
        path = tmp_path / "rig.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_toml(path, Config)

    return load


def test_a_good_file(load):
    config = load('width = 3\n[[parts]]\nname = "a"\nshape = {type = "round", radius = 2}\n')
    assert config == Config(width=3, parts=(Part(name="a", shape=Round(type="round", radius=2.0)),))
    with pytest.raises(pydantic.ValidationError, match="frozen"):
        config.width = 4


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("widht = 3", 'widht: unknown key; the closest known one is "width".'),
        ('width = "3"', 'width: found "3", expected a valid integer.'),
        (
            '[[parts]]\nname="a"\nshape={type="round", radius=2}\n"two\\nlines" = 1',
            'parts[0]."two\\nlines": unknown key; known here: name, shape.',
        ),
        ('[extra]\nname = "a"\nshape = {}', "extra.shape.type: missing."),
        ('[extra]\nname = "a"\nshape = {type = "oval"}', 'extra.shape.type: found "oval", expected "round", "square".'),
        (
            '[[parts]]\nname="a"\nshape={type="square", side=1}\n[[parts]]\nname="b"\nshape={type="square", sied=1}',
            'parts[1].shape.sied: unknown key; the closest known one is "side" (and 1 more).',
        ),
        (
            '[[parts]]\nname="a"\nshape={type="round", radius=0}',
            "parts[0].shape.radius: found 0, expected greater than 0.",
        ),
    ],
)
def test_one_line_that_helps(load, text, line):
    said = refused(ConfigError, lambda: load(text))
    assert said.endswith("rig.toml: " + line)


def test_the_suggestion_is_of_the_level_where_the_key_stands(load):
    # "radius" belongs to another branch of the union, "name" to the level above.
    with pytest.raises(ConfigError, match=r"shape\.nam: unknown key; known here: side, type"):
        load('[extra]\nname="a"\nshape={type="square", side=1, nam=2}')


def test_syntax_errors_have_the_line(load):
    with pytest.raises(ConfigError, match=r"rig\.toml: not valid TOML: .*line 2"):
        load("a = 1\nb = \nc = 3")
    with pytest.raises(ConfigError, match=r"rig\.toml: line 2: not UTF-8"):
        load(b"a = 1\nb = '\xff'")


def test_missing_and_hostile_files(load, tmp_path):
    with pytest.raises(ConfigError, match=r"nothing.toml: no such file"):
        load_toml(tmp_path / "nothing.toml", Config)
    with pytest.raises(ConfigError, match="found a folder, expected a file"):
        load_toml(tmp_path, Config)
    with pytest.raises(ConfigError, match="larger than the 1 MiB"):
        load(b"#" * (MAX_CONFIG_BYTES + 1))
    with pytest.raises(ConfigError, match=r"rig.toml"):
        load("a = " + "[" * 100_000)
    with pytest.raises(ConfigError, match=r"rig.toml"):
        load("width = " + "9" * 10_000)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b'{"a": 1,\n}', "line 2"),
        (b"[NaN]", "NaN"),
        (b"\xff", "UTF-8"),
        (b"[" * 100_000, "nested too deeply"),
    ],
)
def test_json_errors_are_typed(data, message):
    with pytest.raises(ConfigError, match=message):
        parse_json(data, name="x.json", error=ConfigError)


DEEP = ".".join("a" * (MAX_PARTS + 1))
"""A key of one part too many."""


def parsed(text):
    return parse_toml(text.encode(), name="rig.toml", error=ConfigError)


def test_as_many_dotted_parts_as_are_allowed():
    for separator in (".", " . ", "\t.\t"):
        value = parsed(separator.join("a" * MAX_PARTS) + " = 1")
        for _ in range(MAX_PARTS):
            value = value["a"]
        assert value == 1


@pytest.mark.parametrize(
    "text",
    [
        f"x = 'here {DEEP} is text'",
        f'x = "here {DEEP} is text" # and {DEEP} a comment',
        f'x = """\n{DEEP}\n "" {DEEP} \\"""{DEEP}"""',
        f"x = '''\n{DEEP} '' {DEEP}'''''",
        "x = 1979-05-27T07:32:00.999\ny.z = 1.5e3",
    ],
)
def test_dots_that_are_no_keys(text):
    assert "x" in parsed(text)


@pytest.mark.parametrize(
    "before",
    [
        "",
        "x = 'a#'\n",
        'x = "a# \\" # \\\\"\n',
        'x = """a\\""""\n',
        "x = '''a#''''\n",
        'x = """"a""#"""""\n',
    ],
)
@pytest.mark.parametrize("key", [DEEP, DEEP.replace(".", " .\t"), DEEP.replace("a", '"a"'), DEEP.replace("a", "'#'")])
def test_a_key_of_too_many_parts_is_found_behind_anything(before, key):
    # What stands before it is good, so the reader of TOML would come to it.
    assert "a" in parsed(before + "a = 1")
    for text in (f"{key} = 1", f"[{key}]", f"[[{key}]]", f"y = {{{key} = 1}}", f"{key}. . error"):
        with pytest.raises(ConfigError, match=r"line \d: found a key of more than 64 dotted parts"):
            parsed(before + text)


def test_nesting_is_bounded():
    def nested(depth):
        return b"[" * depth + b"1" + b"]" * depth

    assert parse_json(nested(MAX_DEPTH), name="x", error=ConfigError)
    assert parsed("x = " + nested(MAX_DEPTH - 1).decode())
    for depth in (MAX_DEPTH + 1, 300, 980, 100_000):
        with pytest.raises(ConfigError, match="x: nested too deeply, expected at most 64 tables or lists"):
            parse_json(nested(depth), name="x", error=ConfigError)
        with pytest.raises(ConfigError, match=r"rig\.toml: nested too deeply"):
            parsed("x = " + nested(depth).decode())
    tables = "[" + ".".join("a" * 32) + "]\n" + ".".join("b" * 32) + " = "
    assert parsed(tables + "1")
    with pytest.raises(ConfigError, match="nested too deeply"):
        parsed(tables + "[1]")


WORST = {
    "headers": lambda k: f"[{k:x}{'.a' * (MAX_PARTS - 1)}]\n",
    "lists of tables": lambda k: f"[[{k:x}{'.a' * (MAX_PARTS - 1)}]]\n",
    "keys": lambda k: f"{k:x}{'.a' * (MAX_PARTS - 1)}=1\n",
    "unfinished texts": lambda k: '\\"',
    "texts": lambda k: f'"{k:x}".' if k % MAX_PARTS else "=1\n",
    "spaces": lambda k: "a" + " " * 50_000,
}


FAST = [("headers", 5), ("unfinished texts", 1)]


@pytest.mark.parametrize(
    ("kind", "share"),
    [*FAST, *(pytest.param(kind, 1, marks=pytest.mark.slow) for kind in WORST if (kind, 1) not in FAST)],
)
def test_the_worst_mebibyte(kind, share, tmp_path):
    """Measured: 9 s and 0.5 GB of the headers, the others less; without the bound 60 KB took 50 s and 3.8 GB.

    Quickly a fifth of the headers, which then have a fifth of the memory and time beside those of the interpreter.
    """
    parts, size = [], 0
    while size < (MAX_CONFIG_BYTES - 60_000) / share:
        parts.append(WORST[kind](len(parts)))
        size += len(parts[-1])
    path = tmp_path / "rig.toml"
    path.write_text(('x = "' if kind == "unfinished texts" else "") + "".join(parts) + "\\\n")
    code = (
        "import sys\nfrom pathlib import Path\nfrom jaxscan.errors import ConfigError\n"
        "from jaxscan.files.disk.config import parse_toml\n"
        # Not `ru_maxrss`, in which the memory of the parent counts too.
        "peak = lambda: int(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0]) >> 10\n"
        "imported = peak()\n"
        "try:\n    parse_toml(Path(sys.argv[1]).read_bytes(), name='x', error=ConfigError)\n"
        "except ConfigError:\n    pass\n"
        "print(peak() - imported)"
    )
    began = time.monotonic()
    run = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert int(run.stdout) < 900 / share and time.monotonic() - began < 10 + 50 / share


def test_too_many_tables_are_refused_before_they_are_read():
    with pytest.raises(ConfigError, match=r"x\.toml: found 30001 tables, expected at most 30000"):
        parse_toml(b"[[a]]\n" * 30_001, name="x.toml", error=ConfigError)
