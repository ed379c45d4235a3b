"""Configuration errors: one line with the file, the key, the value found and the values allowed."""

from typing import Annotated, Literal

import pydantic
import pytest

from jaxscan.errors import ConfigError
from jaxscan.files.disk import FileModel, Integer, Number, load_toml, parse_json
from jaxscan.files.disk.config import MAX_CONFIG_BYTES


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
        ("zzz = 3", "zzz: unknown key; known here: extra, mode, parts, width."),
        ('width = "3"', 'width: found "3", expected a valid integer.'),
        ("width = true", "width: found true, expected a valid integer."),
        ('mode = "fats"', 'mode: found "fats", expected "fast" or "fine".'),
        ("parts = 3", "parts: found 3, expected a list."),
        ("extra = 3", "extra: found 3, expected a table."),
        ('[extra]\nname = "a"', "extra.shape: missing."),
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
        (
            '[[parts]]\nname="a"\nshape={type="square", side=nan}',
            "parts[0].shape.side: found NaN, expected a finite number.",
        ),
    ],
)
def test_one_line_that_helps(load, text, line):
    with pytest.raises(ConfigError) as caught:
        load(text)
    assert str(caught.value).endswith("rig.toml: " + line)
    assert "\n" not in str(caught.value)


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
        (b"[" * 100_000, "JSON"),
        (b"9" * 5000, "JSON"),
    ],
)
def test_json_errors_are_typed(data, message):
    with pytest.raises(ConfigError, match=message):
        parse_json(data, name="x.json", error=ConfigError)
