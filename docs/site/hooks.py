"""What mkdocs does besides: pages from elsewhere in the repository, and formulae as MathML, which need no script.

A page outside `docs` has its place in the repository as its address, below `repository/`. Links are those of the
repository, so that they lead on there too.
"""

import html
import posixpath
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page


ROOT = Path(__file__).resolve().parents[2]
ELSEWHERE = "repository/"
ROOMS = ("hardware", "experiments")
"""Folders whose pages and pictures are shown beside those of `docs`."""
SINGLE = ("CHANGELOG.md", "CONTRIBUTING.md")
SHOWN = {".md", ".png", ".jpg", ".svg"}

_LINK = re.compile(r"(?<=\]\()([^)#:\s]+)(#[^)\s]*)?(?=\))")
_LIST = re.compile(r"^(?!(?:[-*]|\d+\.) )(\S.*)\n(?=(?:[-*]|1\.) )", re.MULTILINE)
_FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages and pictures of other rooms."""
    found = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*")) if path.suffix in SHOWN]
    for path in [*found, *(ROOT / name for name in SINGLE)]:
        place = path.relative_to(ROOT).as_posix()
        if "build" not in path.parts:
            files.append(File.generated(config, ELSEWHERE + place, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Leads links of the repository to pages of the site, and takes lists as other readers of Markdown do."""
    here = _in_repository(page.file.src_uri)

    def lead(link: re.Match[str]) -> str:
        place = posixpath.normpath(posixpath.join(posixpath.dirname(here), link[1]))
        if files.get_file_from_path(on_site := _on_site(place)) is None:
            if not (ROOT / place).is_file():
                raise PluginError(f"{here}: a link leads to {place}, which is no file")
            # Something to download, such as a drawing or a program.
            files.append(File.generated(config, on_site, abs_src_path=str(ROOT / place)))
        return posixpath.relpath(on_site, posixpath.dirname(page.file.src_uri)) + (link[2] or "")

    kept: list[str] = []

    def keep(fence: re.Match[str]) -> str:
        kept.append(fence[0])
        return f"\0{len(kept) - 1}\0"

    # A list may follow its sentence without a blank line between them, as on other sites.
    text = _LIST.sub(r"\1\n\n", _LINK.sub(lead, _FENCE.sub(keep, markdown)))
    return re.sub("\0(\\d+)\0", lambda mark: kept[int(mark[1])], text)


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Formulae of TeX as MathML."""

    def draw(formula: re.Match[str]) -> str:
        tex = html.unescape(formula[3])
        drawn = convert(tex, display="block" if formula[2] == "[" else "inline")
        if "\\" in drawn:
            raise PluginError(f"{page.file.src_uri}: not known as a formula: {tex}")
        # A narrow screen moves a long formula within its box, and not the page.
        return f'<div class="formula">{drawn}</div>' if formula[2] == "[" else drawn

    return _FORMULA.sub(draw, content)


def _in_repository(place: str) -> str:
    return place.removeprefix(ELSEWHERE) if place.startswith(ELSEWHERE) else f"docs/{place}"


def _on_site(place: str) -> str:
    return place.removeprefix("docs/") if place.startswith("docs/") else ELSEWHERE + place
