"""Answers to words that no verb understands."""

import difflib
import re
from collections.abc import Mapping, Sequence

from jaxscan.cli.help.entries import Entry
from jaxscan.cli.help.page import ALWAYS, PROGRAM


def unknown_verb(word: str, prog: str, verbs: Sequence[str]) -> str:
    """One line on a word that is no verb of these."""
    kind = "option" if word.startswith("-") else "verb"
    options = [name for entry in (PROGRAM if prog == "jaxscan" else ALWAYS) for name in entry.names]
    near = _near(word, options if kind == "option" else verbs)
    return f'"{word}" is no {kind} of {prog}. {near}All there are: {prog} --help'


def mistake(words: Sequence[str], prog: str, entries: Sequence[Entry]) -> str | None:
    """One line on the first word that a verb does not understand, or on what is missing; None for neither."""
    options = {name: entry for entry in (*entries, *ALWAYS) for name in (*entry.names, *entry.unshown)}
    more = f"More: {prog} --help"
    used, arguments, perhaps = set[str](), list[str](), 0
    waiting = list(words)
    while waiting:
        word = waiting.pop(0)
        name, given = _option(word)
        if name not in options:
            if re.match(r"--\w|-[a-zA-Z]", word):
                return f'"{name}" is no option of {prog}. {_near(name, sorted(options))}All there are: {prog} --help'
            arguments.append(word)
            continue
        used.add(name)
        entry = options[name]
        count = len(waiting) if entry.many is None else entry.many
        values = given + [waiting.pop(0) for _ in range(count - len(given)) if waiting and _is_value(waiting, options)]
        if len(values) < count and not (entry.many is None and values):
            return f"{name} needs {entry.value}. {more}"
        for value in values:
            if not _fits(value, entry):
                return f'{name}: found "{value}", expected {_expected(entry)}. {more}'
        # What follows any number of values may be meant as arguments.
        perhaps += len(values) if entry.many is None else 0
    expected = [entry for entry in entries if not entry.names]
    # Where any number is taken, the verb itself says that none is too few.
    missing = [entry for entry in expected if entry.required and entry.many == 1][len(arguments) + perhaps :]
    missing += [entry for entry in entries if entry.names and entry.required and not used & set(entry.names)]
    if missing:
        asked = " ".join([*missing[0].names[-1:], missing[0].value])
        return f"{prog} needs {asked}: {missing[0].text} {more}"
    if len(arguments) > len(expected) and all(entry.many == 1 for entry in expected):
        return f'"{arguments[len(expected)]}" is one word too many for {prog}. {more}'
    return None


def _option(word: str) -> tuple[str, list[str]]:
    """The name in a word, and the value that is in it too."""
    name, sign, value = word.partition("=")
    return (name.replace("_", "-") if name.startswith("--") else name), [value] if sign else []


def _is_value(waiting: Sequence[str], options: Mapping[str, Entry]) -> bool:
    return _option(waiting[0])[0] not in options


def _fits(value: str, entry: Entry) -> bool:
    if entry.choices:
        return value in entry.choices
    if entry.kind in (int, float):
        try:
            entry.kind(value)
        except ValueError:
            return False
    return True


def _expected(entry: Entry) -> str:
    if entry.choices:
        return f"one of {', '.join(entry.choices)}"
    return "a whole number" if entry.kind is int else "a number"


def _near(word: str, names: Sequence[str]) -> str:
    """The name that was meant, as a question; also by its first letters."""
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    close = close or [name for name in names if len(word) > 3 and name.startswith(word)][:1]
    return f'Did you mean "{close[0]}"? ' if close else ""
