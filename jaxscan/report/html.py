"""HTML pages without scripts, fonts or external parts. All text is escaped."""

import html
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from itertools import zip_longest


class Html(str):
    """Markup. Any other string is text, and is escaped."""


# A file of the package itself: no door for those of strangers.
STYLE = resources.files("jaxscan.report").joinpath("page.css").read_text("utf-8")

_VOID = {"img", "source"}
_HYPHEN = re.compile(r"(?<=[0-9]e)-(?=[0-9])|(?<![\w.:/-])-(?=\.?[0-9])")
# A second guard beside the escaping: browsers neither run scripts nor fetch anything.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def escaped(text: object) -> Html:
    """Text as markup; control characters become spaces. Markup is returned as it is."""
    if isinstance(text, Html):
        return text
    shown = "".join(letter if letter.isprintable() else " " for letter in str(text))
    return Html(html.escape(shown, quote=True))


def element(name: str, *content: object, **attributes: str) -> Html:
    """An element; content other than `Html` is escaped. `class_` means `class`, `aria_label` means `aria-label`."""
    names = (key.rstrip("_").replace("_", "-") for key in attributes)
    given = "".join(f' {key}="{escaped(value)}"' for key, value in zip(names, attributes.values(), strict=True))
    if name in _VOID:
        return Html(f"<{name}{given}>")
    return Html(f"<{name}{given}>{''.join(map(escaped, content))}</{name}>")


def joined(parts: Iterable[str]) -> Html:
    """Parts joined by newlines."""
    return Html("\n".join(map(escaped, parts)))


def table(
    columns: Sequence[str], rows: Sequence[Sequence[object]], *, kind: str = "", worse: Sequence[bool] = ()
) -> Html:
    """A table in a box that scrolls on narrow screens.

    Args:
        columns: Titles of the columns; the first column has text, the others numbers. Without any, no head.
        rows: Cells.
        kind: Classes of the box: "tall", "words", "wrap".
        worse: Which rows to mark; rows without an entry are not marked.
    """
    named = [element("thead", element("tr", *(element("th", column) for column in columns)))] if any(columns) else []
    body = [
        element("tr", *(element("td", _cell(cell)) for cell in row), **({"class_": "worse"} if mark else {}))
        for row, mark in zip_longest(rows, worse)
    ]
    # tabindex: a box that scrolls must be reachable by keyboard.
    return element(
        "div", element("table", *named, element("tbody", *body)), class_=f"scroll {kind}".strip(), tabindex="0"
    )


def _cell(cell: object) -> object:
    return minus(cell) if isinstance(cell, str) and not isinstance(cell, Html) else cell


def minus(text: str) -> str:
    """The same text with the sign of minus before its negative numbers and exponents."""
    return _HYPHEN.sub("−", text)


def bullets(items: Iterable[str]) -> Html:
    """A bulleted list of texts or markup."""
    return element("ul", *(element("li", item) for item in items))


def captioned(drawn: Html, *caption: object, **attributes: str) -> Html:
    """A figure and its caption; a class "wide" gives it the width of the page."""
    return element("figure", drawn, element("figcaption", *caption), **attributes)


def beside(*parts: Html) -> Html:
    """Figures and tables side by side, where there is room."""
    return element(
        "div", *(part if part.startswith("<figure") else element("div", part) for part in parts), class_="figures"
    )


def verdict(kind: str, headline: str, *explanation: object) -> Html:
    """The card that comes first; `kind` is "good", "plain", "bad" or "open"."""
    return element("div", element("strong", headline), *explanation, class_=f"verdict {kind}")


def tiles(values: Iterable[tuple[str, str]], note: str = "") -> Html:
    """Values, each with its words, and a remark below; nothing without any."""
    shown = [element("div", element("b", value), element("span", words), class_="tile") for value, words in values]
    parts = [element("div", *shown, class_="tiles")] + ([element("p", note, class_="note")] if note else [])
    return joined(parts) if shown else Html()


def section(title: str, *content: object) -> Html:
    """A section of the page: its heading, a sentence, figures and tables."""
    return element("section", element("h2", title), *content)


def provenance(found: Mapping[str, object], *origins: object) -> Html:
    """The foot of a page: captures and versions, as far as the provenance in a file is well-formed."""
    captures, versions = found.get("captures"), found.get("versions")
    listed = [one for one in (*origins, *_list(captures)) if isinstance(one, dict)]
    lines = [f"{one.get('name')}: {one.get('digest')}" for one in listed]
    if isinstance(versions, dict):
        lines.append(", ".join(f"{name} {version}" for name, version in versions.items()))
    return element("footer", *(element("p", line) for line in lines))


def _list(found: object) -> Sequence[object]:
    return found if isinstance(found, list | tuple) else ()


def page(kind: str, heading: str, words: str, notes: Iterable[str], *content: Html | None) -> str:
    """A complete HTML document that fetches nothing and runs no scripts.

    Args:
        kind: What it is, for the browser's title.
        heading: Its heading.
        words: A line below it.
        notes: Remarks that come first.
        content: Sections; those that are None are left out.
    """
    header = element("header", element("h1", heading), element("p", words))
    parts = [header, *(element("p", note, class_="note") for note in notes), *(part for part in content if part)]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f"{element('title', kind)}\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"{element('main', joined(parts))}\n</body>\n</html>\n"
    )
