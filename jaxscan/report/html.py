"""HTML pages without scripts, fonts or external parts. All text is escaped."""

import html
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest


class Html(str):
    """Markup. Any other string is text, and is escaped."""


STYLE = """
:root{--ink:#1c2530;--soft:#5b6672;--line:#e3e7eb;--paper:#fff;--wash:#f6f7f9;--blue:#0072b2;--good:#00735c;
--bad:#b84300;--open:#7a5c00}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--wash);color:var(--ink);font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,
"Helvetica Neue",Arial,sans-serif;overflow-wrap:break-word}
main{max-width:1180px;margin:0 auto;padding:2.2rem 1.25rem 4rem}
header p,.note{color:var(--soft)}
h1{font-size:1.75rem;line-height:1.2;margin:0 0 .3rem;letter-spacing:-.01em}
h2{font-size:1.2rem;line-height:1.3;margin:2.6rem 0 .35rem}
h3{font-size:1rem;margin:1.4rem 0 .3rem}
p{margin:.35rem 0 .8rem;max-width:50rem}
ul{margin:.35rem 0 .8rem;padding-left:1.2rem;max-width:50rem}
li{margin:.25rem 0}
.verdict{background:var(--paper);border:1px solid var(--line);border-left:6px solid var(--soft);border-radius:6px;
padding:1.1rem 1.3rem;margin:1.2rem 0}
.verdict.good{border-left-color:var(--good)}.verdict.bad{border-left-color:var(--bad)}
.verdict.open{border-left-color:#e0a800}
.verdict strong{display:block;font-size:1.3rem;line-height:1.3;margin-bottom:.25rem}
.verdict.good strong{color:var(--good)}.verdict.bad strong{color:var(--bad)}.verdict.open strong{color:var(--open)}
.verdict p:last-child{margin-bottom:0}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(165px,1fr));gap:.7rem;margin:1rem 0}
.tile{background:var(--paper);border:1px solid var(--line);border-radius:6px;padding:.7rem .9rem}
.tile b{display:block;font-size:1.35rem;font-weight:600;line-height:1.25;white-space:nowrap}
.tile span{display:block;color:var(--soft);font-size:.85rem;line-height:1.35}
.scroll{overflow-x:auto;background:var(--paper);border:1px solid var(--line);border-radius:6px;margin:.6rem 0}
.tall{max-height:30rem;overflow-y:auto}
table{border-collapse:collapse;width:100%;font-size:.9rem;font-variant-numeric:tabular-nums}
th,td{padding:.36rem .8rem;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
tr:last-child td{border-bottom:0}
th{font-weight:600;color:var(--soft);font-size:.8rem;white-space:normal;vertical-align:bottom}
thead th{position:sticky;top:0;background:var(--paper);box-shadow:inset 0 -1px 0 var(--line)}
th:first-child,td:first-child{text-align:left}
.words td:last-child,.words th:last-child{text-align:left;white-space:normal;min-width:17rem}
@media (max-width:640px){.wrap td{white-space:normal}}
tr.worse td{background:#fff4ec}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,31rem),1fr));gap:.9rem;margin:.8rem 0}
.panels{display:grid;grid-template-columns:repeat(6,1fr);gap:.6rem;margin:.8rem 0}
@media (max-width:1100px){.panels{grid-template-columns:repeat(4,1fr)}}
@media (max-width:760px){.panels{grid-template-columns:repeat(3,1fr)}}
@media (max-width:520px){.panels{grid-template-columns:repeat(2,1fr)}
.tile:last-child:nth-child(odd){grid-column:1/-1}}
.figures>:last-child:nth-child(odd){grid-column:1/-1}
.panels figure{min-width:0}.panels figure:target{outline:3px solid var(--blue)}
.panels img{border-radius:3px;margin-top:.3rem}a{color:var(--blue)}
figure{margin:0;background:var(--paper);border:1px solid var(--line);border-radius:6px;padding:.7rem .7rem .5rem}
.panels figure{padding:.35rem}
figure.wide{overflow-x:auto}figure.wide svg{min-width:34rem;margin:0 auto}figure svg{margin:0 auto}
figcaption{color:var(--soft);font-size:.85rem;line-height:1.4;padding:.3rem .3rem .2rem}
figcaption b{color:var(--ink)}
figure.photograph{padding:0;overflow:hidden}img{display:block;width:100%;height:auto}
.panels figcaption{font-size:.78rem;padding:.1rem .2rem}
svg{display:block;width:100%;height:auto}
svg text{font-family:inherit!important}
details summary{cursor:pointer;color:var(--blue);margin:.4rem 0}
footer{margin-top:3rem;border-top:1px solid var(--line);padding-top:1rem;color:var(--soft);font-size:.85rem}
@media screen and (prefers-color-scheme:dark){:root{--ink:#e4e9ee;--soft:#a3adb8;--line:#343d47;--paper:#1b2128;
--wash:#12171c;--blue:#62b4ee;--good:#45cfae;--bad:#ff9c61;--open:#e9c34d;color-scheme:dark}
figure{--ink:#1c2530;--soft:#5b6672;--line:#e3e7eb;--paper:#f4f6f8;color:var(--ink)}
tr.worse td{background:#3a2a20}}
@media (max-width:520px){body{font-size:15px}main{padding:1.2rem .8rem 3rem}th,td{padding:.32rem .55rem}
.tile b{font-size:1.15rem}.tiles{grid-template-columns:repeat(2,1fr);gap:.5rem}figure{padding:.35rem}}
@media print{body{background:#fff;font-size:10pt}main{max-width:none;padding:0}.tall{max-height:none}
figure.wide svg{min-width:0}
figure,.tile,.verdict,tr{break-inside:avoid}h2,h3{break-after:avoid}.scroll{overflow:visible}
.figures{grid-template-columns:1fr 1fr}.panels{grid-template-columns:repeat(4,1fr)}
.tiles{grid-template-columns:repeat(4,1fr)}th,td{padding:.16rem .5rem}@page{margin:14mm}}
"""

_VOID = {"img", "source"}
"""Elements that have no end."""
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
