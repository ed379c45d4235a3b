"""Pages of help as plain text, folded to the width of the terminal."""

import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxscan.cli.help.entries import Entry, entries_of, paragraphs


GROUPS = {
    "Begin": ("demo", "init", "design", "doctor"),
    "Calibrate": ("board", "simulate", "calibrate", "recalibrate", "report"),
    "Scan": ("scan", "console", "import", "reconstruct"),
    "Look and measure": ("view", "measure", "panorama", "plan", "orthophoto"),
    "Give to other programs": ("convert", "align", "mesh"),
    "Many captures": ("project", "batch"),
}
"""The verbs as the first page lists them."""
ALWAYS = (
    Entry(("-h", "--help"), "", "Show this page."),
    Entry(("--debug",), "", "Show where in the program an error arose."),
)
"""Options of every verb."""
PROGRAM = (
    Entry(("-h", "--help"), "", "Show this page."),
    Entry(("--version",), "", "Show the version."),
    Entry(("--completion",), "bash|zsh|fish", "Print what makes this shell complete verbs and options."),
)
"""Options of `jaxscan` without a verb."""
_WIDEST, _NARROWEST = 100, 24
_BESIDE = 60
"""Narrower pages have each text below its name, not beside it."""


def overview(prog: str, description: str, verbs: Mapping[str, str]) -> str:
    """The page that lists verbs, each with the first words of its docstring."""
    lines = [f"usage: {prog} [-h] VERB ...", "", *_folded(description)]
    grouped = {title: [verb for verb in names if verb in verbs] for title, names in GROUPS.items()}
    rest = [verb for verb in verbs if not any(verb in names for names in grouped.values())]
    grouped["More" if len(rest) < len(verbs) else "Verbs"] = rest
    for title, names in grouped.items():
        if names:
            lines += ["", f"{title}:", *_listed([(name, short(verbs[name])) for name in names])]
    options = PROGRAM if prog == "jaxscan" else ALWAYS[:1]
    lines += ["", "Options:", *_listed([(_names(entry), entry.text) for entry in options])]
    lines += ["", *_folded(f"More about a verb, with an example: {prog} VERB --help")]
    return "\n".join(lines) + "\n"


def verb_page(prog: str, function: Callable[..., Any]) -> str:
    """The page of one verb: how it is called, what it does, and what it can be given."""
    entries = entries_of(function)
    given = [entry for entry in entries if not entry.names]
    needed = [entry for entry in entries if entry.names and entry.required]
    others = [entry for entry in entries if entry.names and not entry.required]
    call = [prog, "[-h]", *(entry.value if entry.required else f"[{entry.value}]" for entry in given)]
    call += [f"{entry.names[-1]} {entry.value}" for entry in needed] + (["[OPTIONS]"] if others else [])
    lines = textwrap.wrap(f"usage: {' '.join(call)}", _width(), subsequent_indent="  ", break_on_hyphens=False)
    for paragraph in paragraphs(function):
        lines += ["", *_folded(paragraph)]
    for title, group in (("Arguments", given), ("Needed", needed), ("Options", [*others, *ALWAYS])):
        if group:
            lines += ["", f"{title}:", *_listed([(_names(entry), entry.text) for entry in group])]
    return "\n".join(lines) + "\n"


def short(line: str) -> str:
    """What a verb does, without its example."""
    return line.partition(": `")[0].partition(" (`")[0].rstrip(".") + "."


def _names(entry: Entry) -> str:
    return " ".join(part for part in (", ".join(entry.names), entry.value) if part)


def _listed(rows: Sequence[tuple[str, str]]) -> list[str]:
    """Names with their texts beside them, where there is room, else below."""
    width = _width()
    column = min(max(len(name) for name, _ in rows) + 4, 32)
    if width < _BESIDE:
        column = 6
    lines = []
    for name, text in rows:
        folded = textwrap.wrap(text, width - column, break_on_hyphens=False)
        if len(name) + 4 <= column:
            lines.append(f"  {name}".ljust(column) + (folded.pop(0) if folded else ""))
        else:
            lines += textwrap.wrap(name, width, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False)
        lines += [" " * column + line for line in folded]
    return [line.rstrip() for line in lines]


def _folded(text: str) -> list[str]:
    return textwrap.wrap(text, _width(), break_on_hyphens=False)


def _width() -> int:
    return max(min(shutil.get_terminal_size().columns, _WIDEST), _NARROWEST)
