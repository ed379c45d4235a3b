"""What a verb can be given, by its signature and docstring: its page, its words as values, completion by shells."""

import difflib
import inspect
import re
import shlex
import shutil
import textwrap
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints


_LONGEST_CHOICES = 32
"""Choices longer than this are listed in the text, not in the place of the value."""


class Arg(NamedTuple):
    """Mark of a parameter's type: what stands for its value, its short name, and its text if the docstring has none."""

    value: str = ""
    short: str = ""
    text: str = ""


class Entry(NamedTuple):
    """An argument or option of a verb."""

    key: str
    """Name of the parameter."""
    names: tuple[str, ...]
    """Names as pages show them, short ones first; none for an argument."""
    value: str
    """Stands for the value; "" for a switch."""
    text: str
    choices: tuple[str, ...] = ()
    required: bool = False
    kind: type = str
    """Type of one value."""
    many: int | None = 1
    """How many values there are; None for any number of them."""
    unshown: tuple[str, ...] = ()
    """Hidden names: the `--no-` form of a switch that is off by default."""


def entries_of(function: Callable[..., Any]) -> list[Entry]:
    """All arguments and options of a verb, as its function lists them."""
    hints = get_type_hints(function, include_extras=True)
    texts = _texts(function)
    parameters = inspect.signature(function).parameters.values()
    return [_entry(one, hints[one.name], texts) for one in parameters]


def paragraphs(function: Callable[..., Any]) -> list[str]:
    """The docstring without its list of arguments, one string a paragraph."""
    text = re.split(r"^(?:Args|Raises|Returns):$", inspect.getdoc(function) or "", flags=re.MULTILINE)[0]
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _texts(function: Callable[..., Any]) -> dict[str, str]:
    """The text of each argument in the docstring."""
    found = re.search(r"^Args:\n((?:    .*\n?|\n)*)", inspect.getdoc(function) or "", flags=re.MULTILINE)
    parts = re.split(r"^    (\w+): ", found[1], flags=re.MULTILINE)[1:] if found else []
    return {name: " ".join(text.split()) for name, text in zip(parts[::2], parts[1::2], strict=True)}


def _entry(parameter: inspect.Parameter, hint: Any, texts: Mapping[str, str]) -> Entry:
    kind, mark = get_args(hint) if get_origin(hint) is Annotated else (hint, Arg())
    key, positional, default = parameter.name, parameter.kind is parameter.POSITIONAL_ONLY, parameter.default
    one, count = _each(_without_none(kind))
    choices = tuple(map(str, get_args(one))) if get_origin(one) is Literal else ()
    text: str = mark.text or texts.get(key, "")
    option, required = "--" + key.replace("_", "-"), default is parameter.empty
    if one is bool:
        against = f"--no-{option.removeprefix('--')}"
        if default is False:
            return Entry(key, (option,), "", text, many=0, unshown=(against,))
        return Entry(key, (option, against), "", f"{text} Default: on." if default else text, many=0)
    value = mark.value or " ".join([_value(key, one, choices, upper=positional)] * (count or 1))
    if count is None:
        value += " ..."
    if choices and "|" not in value:
        text = f"{text} One of {', '.join(choices)}."
    if default not in (None, parameter.empty, (), ""):
        shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
        text = f"{text} Default: {'this folder' if default == Path() else shown}."
    names = () if positional else (*filter(None, [mark.short]), option)
    return Entry(key, names, value, text, choices, required, type(get_args(one)[0]) if choices else one, count)


def _without_none(kind: Any) -> Any:
    if get_origin(kind) not in (Union, types.UnionType):
        return kind
    (left,) = [one for one in get_args(kind) if one is not type(None)]
    return left


def _each(kind: Any) -> tuple[Any, int | None]:
    """The type of one value, and how many there are; None for any number of them."""
    if get_origin(kind) is not tuple:
        return kind, 1
    inside = get_args(kind)
    return inside[0], None if inside[-1] is Ellipsis else len(inside)


def _value(name: str, one: Any, choices: tuple[str, ...], *, upper: bool) -> str:
    """A plain word that stands for a value."""
    if choices:
        listed = "|".join(choices)
        return listed if len(listed) <= _LONGEST_CHOICES else "NAME"
    if upper:
        return name.upper().replace("_", "-")
    if one in (int, float):
        return "ANGLE" if name.endswith("_deg") else "NUMBER"
    return "PATH" if one is Path else "TEXT"


GROUPS = {
    "Begin": ("demo", "init", "design", "doctor"),
    "Calibrate": ("board", "simulate", "calibrate", "recalibrate", "report"),
    "Scan": ("scan", "console", "import", "reconstruct"),
    "Look and measure": ("info", "view", "measure", "panorama", "plan", "orthophoto"),
    "Give to other programs": ("convert", "clean", "align", "register", "mesh"),
    "Many captures": ("project", "batch"),
}
"""The verbs as the first page lists them."""
ALWAYS = (
    Entry("json", ("--json",), "FILE", "Write the result as JSON too (- for standard output)."),
    Entry("help", ("-h", "--help"), "", "Show this page.", many=0),
    Entry("debug", ("--debug",), "", "Show where in the program an error arose.", many=0),
)
"""Options of every verb."""
PROGRAM = (
    Entry("help", ("-h", "--help"), "", "Show this page.", many=0),
    Entry("version", ("--version",), "", "Show the version.", many=0),
    Entry("completion", ("--completion",), "bash|zsh", "Print what makes this shell complete verbs and options."),
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
    options = PROGRAM if prog == "jaxscan" else PROGRAM[:1]
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


def unknown_verb(word: str, prog: str, verbs: Sequence[str]) -> str:
    """One line on a word that is no verb of these."""
    kind = "option" if word.startswith("-") else "verb"
    alone, behind = ([name for entry in entries for name in entry.names] for entries in (PROGRAM, ALWAYS))
    if word in behind:
        near = "It follows the verb. "
    elif word in alone and prog == "jaxscan":
        near = "It stands alone. "
    else:
        near = _near(word, verbs if kind == "verb" else alone if prog == "jaxscan" else behind)
    return f'"{word}" is no {kind} of {prog}. {near}All there are: {prog} --help'


class Mistake(Exception):
    """A line on the first word that a verb does not understand, or on what is missing."""


def read_words(words: Sequence[str], prog: str, entries: Sequence[Entry]) -> dict[str, Any]:
    """The values that the words of a verb give, by the names of its parameters and those of `ALWAYS`.

    Raises:
        Mistake: If a word is not understood, or one is missing.
    """
    options = {name: entry for entry in (*entries, *ALWAYS) for name in (*entry.names, *entry.unshown)}
    more = f"More: {prog} --help"
    found, arguments, waiting = dict[str, Any](), list[str](), list(words)
    while waiting:
        word = waiting.pop(0)
        if word == "--":
            arguments += waiting
            break
        name, given = _option(word)
        if name not in options:
            if re.match(r"--\w|-[a-zA-Z]", word):
                near = _near(name, sorted(options))
                raise Mistake(f'"{name}" is no option of {prog}. {near}All there are: {prog} --help')
            arguments.append(word)
            continue
        entry = options[name]
        if entry.many == 0:
            if given:
                raise Mistake(f"{name} takes no value. {more}")
            found[entry.key] = not (name.startswith("--no-") and name != f"--{entry.key.replace('_', '-')}")
            continue
        count = len(waiting) if entry.many is None else entry.many
        values = given + [waiting.pop(0) for _ in range(count - len(given)) if waiting and _is_value(waiting, options)]
        if not values or (entry.many is not None and len(values) < count):
            raise Mistake(f"{name} needs {entry.value.removesuffix(' ...')}. {more}")
        try:
            found[entry.key] = _converted(values, entry)
        except ValueError as problem:
            raise Mistake(f"{name}: {problem}. {more}") from problem
    expected = [entry for entry in entries if not entry.names]
    # Where any number of words is allowed, the verb itself refuses none.
    missing = [entry for entry in expected if entry.required and entry.many == 1][len(arguments) :]
    missing += [entry for entry in entries if entry.names and entry.required and entry.key not in found]
    if missing:
        needed = " ".join([*missing[0].names[-1:], missing[0].value])
        raise Mistake(f"{prog} needs {needed}: {missing[0].text} {_to_type(prog, words, arguments, missing)}{more}")
    if len(arguments) > len(expected) and all(entry.many == 1 for entry in expected):
        raise Mistake(f'"{arguments[len(expected)]}" is one word too many for {prog}. {more}')
    for entry in expected:
        some = arguments if entry.many is None else arguments[:1]
        if some or entry.many is None:
            found[entry.key], arguments = _converted(some, entry), arguments[len(some) :]
    return found


def _to_type(prog: str, words: Sequence[str], arguments: Sequence[str], missing: Sequence[Entry]) -> str:
    """The completed command if only the output file is missing and its suffix is known; else empty."""
    suffix = re.search(r"\((\.\w+)", missing[0].text)
    if suffix is None or len(missing) > 1 or not arguments or "--output" not in missing[0].names:
        return ""
    output = f"{Path(arguments[0]).stem}-{prog.split()[-1]}{suffix[1]}"
    return f"Type for example: {prog} {shlex.join([*words, '-o', output])}. "


def _option(word: str) -> tuple[str, list[str]]:
    """The name in a word, and the value that is in it too."""
    name, sign, value = word.partition("=")
    return (name.replace("_", "-") if name.startswith("--") else name), [value] if sign else []


def _is_value(waiting: Sequence[str], options: Mapping[str, Entry]) -> bool:
    return _option(waiting[0])[0] not in options


def _converted(values: Sequence[str], entry: Entry) -> Any:
    """Words as the values of a parameter.

    Raises:
        ValueError: If one is none of the choices, or no number.
    """
    made = []
    for value in values:
        try:
            if entry.choices and value not in entry.choices:
                raise ValueError
            made.append(entry.kind(value))
        except ValueError:
            raise ValueError(f'found "{value}", expected {_expected(entry)}') from None
    return made[0] if entry.many == 1 else tuple(made)


def _expected(entry: Entry) -> str:
    if entry.choices:
        return f"one of {', '.join(entry.choices)}"
    return "a whole number" if entry.kind is int else "a number"


def _near(word: str, names: Sequence[str]) -> str:
    """The most similar name, or the one that begins so, as a question; else empty."""
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    close = close or [name for name in names if len(word) > 3 and name.startswith(word)][:1]
    return f'Did you mean "{close[0]}"? ' if close else ""


SHELLS = ("bash", "zsh")


class Verb(NamedTuple):
    """A verb as completion knows it."""

    words: tuple[str, ...]
    """Its name, after that of a verb above it."""
    entries: Sequence[Entry]


def completion(shell: str, verbs: Sequence[Verb]) -> str:
    """The script for one of `SHELLS`, to be evaluated by it."""
    # zsh runs the functions of bash.
    before = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"
    values, options, below = [], [], dict[str, list[str]]()
    for verb in verbs:
        name = " ".join(verb.words)
        if len(verb.words) == 2:
            below.setdefault(verb.words[0], []).append(verb.words[1])
        for entry in verb.entries:
            if entry.choices:
                case = " | ".join(f"'{name} {option}'" for option in entry.names)
                values.append(f"        {case}) words='{' '.join(entry.choices)}' ;;")
        names = [option for entry in (*verb.entries, *ALWAYS) for option in entry.names]
        options.append(f"        '{name}') words='{' '.join(names)}' ;;")
    first = [verb.words[0] for verb in verbs if len(verb.words) == 1]
    first += [name for entry in PROGRAM for name in entry.names]
    cases = [f"        {above}) words='{' '.join(names)}' ;;" for above, names in below.items()]
    script = _SCRIPT.format(
        below="|".join(below),
        first=" ".join(first),
        cases="\n".join(cases),
        values="\n".join(values),
        options="\n".join(options),
    )
    return (before if shell == "zsh" else "") + script


_SCRIPT = """\
_jaxscan() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words=""
    local verb="${{COMP_WORDS[1]}}" depth=1
    case "$verb" in {below}) verb="$verb ${{COMP_WORDS[2]}}"; depth=2 ;; esac
    if [ "$COMP_CWORD" -eq 1 ]; then
        words='{first}'
    elif [ "$COMP_CWORD" -eq "$depth" ]; then
        case "${{COMP_WORDS[1]}}" in
{cases}
        esac
    else
        case "$verb $before" in
{values}
        esac
    fi
    if [ -z "$words" ] && [ "$COMP_CWORD" -gt "$depth" ] && [ "${{word:0:1}}" = "-" ]; then
        case "$verb" in
{options}
        esac
    fi
    COMPREPLY=()
    if [ -n "$words" ]; then COMPREPLY=($(compgen -W "$words" -- "$word")); fi
}}
complete -o default -F _jaxscan jaxscan
"""
