"""Scripts with which a shell completes verbs, options and their choices; names of files are left to the shell."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from jaxscan.cli.help.entries import Entry
from jaxscan.cli.help.page import ALWAYS, PROGRAM


SHELLS = ("bash", "zsh", "fish")


class Verb(NamedTuple):
    """A verb as completion knows it."""

    words: tuple[str, ...]
    """Its name, after that of a verb above it."""
    says: str
    entries: Sequence[Entry]


def completion(shell: str, verbs: Sequence[Verb]) -> str:
    """The script for one of `SHELLS`, to be evaluated by it."""
    if shell == "fish":
        return _fish(verbs)
    # zsh runs the functions of bash.
    before = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"
    return (before if shell == "zsh" else "") + _bash(verbs)


def _bash(verbs: Sequence[Verb]) -> str:
    values, options = [], []
    for verb in verbs:
        name = " ".join(verb.words)
        for entry in verb.entries:
            if entry.choices:
                asked = " | ".join(f"'{name} {option}'" for option in entry.names)
                values.append(f"        {asked}) words='{' '.join(entry.choices)}' ;;")
        options.append(f"        '{name}') words='{' '.join(_options(verb.entries))}' ;;")
    below = [f"        {above}) words='{' '.join(names)}' ;;" for above, names in _below(verbs).items()]
    first = [verb.words[0] for verb in verbs if len(verb.words) == 1]
    first += [name for entry in PROGRAM for name in entry.names]
    return "\n".join(
        [
            "_jaxscan() {",
            '    local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" words=""',
            '    local verb="${COMP_WORDS[1]}" depth=1',
            f'    case "$verb" in {"|".join(_below(verbs))}) verb="$verb ${{COMP_WORDS[2]}}"; depth=2 ;; esac',
            '    if [ "$COMP_CWORD" -eq 1 ]; then',
            f"        words='{' '.join(first)}'",
            '    elif [ "$COMP_CWORD" -eq "$depth" ]; then',
            '        case "${COMP_WORDS[1]}" in',
            *below,
            "        esac",
            "    else",
            '        case "$verb $before" in',
            *values,
            "        esac",
            "    fi",
            '    if [ -z "$words" ] && [ "$COMP_CWORD" -gt "$depth" ] && [ "${word:0:1}" = "-" ]; then',
            '        case "$verb" in',
            *options,
            "        esac",
            "    fi",
            "    COMPREPLY=()",
            '    if [ -n "$words" ]; then COMPREPLY=($(compgen -W "$words" -- "$word")); fi',
            "}",
            "complete -o default -F _jaxscan jaxscan",
            "",
        ]
    )


def _fish(verbs: Sequence[Verb]) -> str:
    lines = []
    for entry in PROGRAM:
        values = f" -x -a {_quoted(entry.value.replace('|', ' '))}" if entry.value else ""
        lines.append(
            f"complete -c jaxscan -n __fish_use_subcommand{_fish_names(entry)}{values} -d {_quoted(entry.text)}"
        )
    for verb in verbs:
        *above, name = verb.words
        here = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in above) or "__fish_use_subcommand"
        lines.append(f"complete -c jaxscan -n {_quoted(here)} -f -a {name} -d {_quoted(verb.says)}")
        inside = _quoted("; and ".join(f"__fish_seen_subcommand_from {word}" for word in verb.words))
        for entry in (*verb.entries, *ALWAYS):
            if entry.names:
                values = f" -x -a {_quoted(' '.join(entry.choices))}" if entry.choices else " -r" * bool(entry.value)
                told = _quoted(entry.text.partition(". ")[0])
                lines.append(f"complete -c jaxscan -n {inside}{_fish_names(entry)}{values} -d {told}")
    return "\n".join(lines) + "\n"


def _fish_names(entry: Entry) -> str:
    return "".join(f" -l {name[2:]}" if name.startswith("--") else f" -s {name[1:]}" for name in entry.names)


def _quoted(text: str) -> str:
    """A word of fish that is nothing but this text."""
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


def _options(entries: Sequence[Entry]) -> list[str]:
    return [name for entry in (*entries, *ALWAYS) for name in entry.names]


def _below(verbs: Sequence[Verb]) -> Mapping[str, list[str]]:
    """The verbs below each verb that has some."""
    found: dict[str, list[str]] = {}
    for verb in verbs:
        if len(verb.words) == 2:
            found.setdefault(verb.words[0], []).append(verb.words[1])
    return found
