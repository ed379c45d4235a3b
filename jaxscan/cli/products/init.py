"""`jaxscan init`: a configuration to start from."""

import difflib
import importlib.resources
import os
import re
from pathlib import Path
from typing import Annotated

import tyro

from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.errors import ConfigError, OptionError


Name = Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]


def init(
    name: Name = None,
    /,
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    list: bool = False,
    json: JsonTarget = None,
) -> None:
    """Write a configuration to start from: `jaxscan init scan.toml`. All there are: `jaxscan init --list`.

    Args:
        name: The configuration, with or without .toml; without a name they are listed.
        output: File to write, if not NAME in this folder; an existing one is refused.
        list: Say which configurations there are, in a line each.
        json: Write the result as JSON too.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.files.disk import write_atomically

    with importlib.resources.as_file(importlib.resources.files("jaxscan.data") / "configs") as folder:
        known = {path.stem: path for path in sorted(folder.glob("*.toml"))}
        if list or name is None:
            check_json(json)
            lines = {f"{stem}.toml": _first_sentence(_text(path)) for stem, path in known.items()}
            for file, line in lines.items():
                console(json).print(f"{file:24} {line}")
            emit_json(json, "init", {"written": None, "configurations": lines})
            return
        chosen = known.get(name.removesuffix(".toml"))
        if chosen is None:
            closest = difflib.get_close_matches(name[:64], known, n=1, cutoff=0.0)[0]
            raise OptionError(
                f"found {name[:64]!r}, expected a configuration that `jaxscan init --list` names; the closest is "
                f'"{closest}.toml".'
            )
        text, target = _text(chosen), Path(chosen.name) if output is None else output
    check_paths([], [*file_at("--output", target), *file_at("--json", json)])
    check_json(json)
    if os.path.lexists(target):
        raise OptionError(f"{target}: exists, and may be yours; choose another name with -o, or move it away.")
    write_atomically(target, text.encode())
    console(json).print(f"written: {target}")
    emit_json(json, "init", {"written": str(target), "configuration": chosen.name})


def _text(path: Path) -> str:
    from jaxscan.files.disk import MEGABYTE, read_bounded

    return read_bounded(path, MEGABYTE, error=ConfigError).decode()


def _first_sentence(text: str) -> str:
    """The first sentence of the comment at the beginning of a configuration."""
    comment = re.match(r"(?:#.*\n)+", text)
    words = " ".join(line.lstrip("# ") for line in comment[0].splitlines()) if comment else ""
    return re.split(r"(?<=\.) ", words, maxsplit=1)[0]
