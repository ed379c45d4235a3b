"""The site as it is built: complete, and asking nothing of another machine."""

import importlib.util
import logging
import re
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import Files

import jaxscan
from tests.browser.driver import NARROW, WIDE, Looks
from tests.documentation.pages import ROOT


FETCHED = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\bsrc=["']?([^"'\s>]+)|<link\b[^>]*\bhref=["']?([^"'\s>]+)"""
)
STYLES = re.compile(r"""url\(["']?([^"')]+)|@import ["']([^"']+)""")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    said = []
    listener = logging.Handler(logging.WARNING)
    listener.emit = said.append
    logging.getLogger("mkdocs").addHandler(listener)
    try:
        build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder)))
    finally:
        logging.getLogger("mkdocs").removeHandler(listener)
    assert not [record.getMessage() for record in said]
    return folder


def named_hosts(text, kind):
    found = ["".join(groups) for groups in kind.findall(text)]
    return [place for place in found if "//" in place and not place.startswith("data:")]


@pytest.mark.slow
def test_no_page_asks_another_machine(site):
    for page in site.rglob("*.html"):
        assert not named_hosts(page.read_text(), FETCHED), page.name
    for style in site.rglob("*.css"):
        assert not named_hosts(style.read_text(), STYLES), style.name
    # The theme draws diagrams by a script that it fetches: no page may have one.
    assert not [page.name for page in site.rglob("*.html") if 'class="mermaid"' in page.read_text()]


@pytest.mark.slow
def test_formulae_are_drawn(site):
    mathematics = (site / "mathematics.html").read_text()
    assert mathematics.count("<math ") > 80
    assert not [page.name for page in site.rglob("*.html") if "arithmatex" in page.read_text()]


@pytest.mark.slow
def test_every_public_name_is_described(site):
    text = "".join(page.read_text() for page in (site / "api").glob("*.html"))
    shown = set(re.findall(r'id="jaxscan\.(\w+)"', text))
    assert set(jaxscan.__all__) - {"__version__"} <= shown


class Page:
    """A page of `docs`, as hooks are given it."""

    class file:
        src_uri = "page.md"


@pytest.fixture
def hooks():
    described = importlib.util.spec_from_file_location("site_hooks", ROOT / "docs" / "site" / "hooks.py")
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    return module


def test_what_is_no_formula_is_refused(hooks):
    draw = lambda tex: hooks.on_page_content(f'<span class="arithmatex">\\({tex}\\)</span>', Page, None, None)
    assert draw(r"\frac{d}{m}").startswith("<math ") and "arithmatex" not in draw("a &lt; b")
    with pytest.raises(PluginError, match="not known as a formula"):
        draw(r"\nobody x")


def test_links_lead_to_the_site_and_lists_are_lists(hooks, monkeypatch):
    config = load_config(str(ROOT / "mkdocs.yml"))
    # Who adds a file, as mkdocs notes it while it calls a hook.
    monkeypatch.setattr(config.plugins, "_current_plugin", "hooks", raising=False)
    files = hooks.on_files(Files([]), config)
    read = lambda text: hooks.on_page_markdown(text, Page, config, files)
    assert read("[wire](../hardware/PROTOCOL.md#2-session)") == "[wire](repository/hardware/PROTOCOL.md#2-session)"
    assert files.get_file_from_path("repository/hardware/firmware/pins.h") is None
    assert read("[pins](../hardware/firmware/pins.h)") == "[pins](repository/hardware/firmware/pins.h)"
    assert files.get_file_from_path("repository/hardware/firmware/pins.h")
    assert read("Two:\n- one\n  more\n- two") == "Two:\n\n- one\n  more\n- two"
    kept = "```\nTwo:\n- [one](nowhere.md)\n```"
    assert read(kept) == kept
    for place in ("nowhere.md", "../hardware"):
        with pytest.raises(PluginError, match="no file"):
            read(f"[it]({place})")


@pytest.fixture(scope="module")
def address(site):
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *what):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("size", [(1400, 900), NARROW], ids=["desk", "telephone"])
def test_the_first_page_does_not_scroll_sideways(browser, address, size):
    looks = Looks(browser)
    looks.open(f"{address}/index.html", size)
    assert looks.too_wide() <= 0


@pytest.mark.slow
@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["desk", "telephone"])
@pytest.mark.parametrize("page", ["index", "first-room", "mathematics", "api/clouds", "repository/hardware/PROTOCOL"])
def test_pages_fit_a_window(browser, address, page, size):
    looks = Looks(browser)
    looks.open(f"{address}/{page}.html", size)
    looks.until(lambda: browser.execute_script("return document.readyState") == "complete")
    assert looks.too_wide() <= 0
    asked = browser.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
    assert asked and all(name.startswith(address) for name in asked), asked
    assert not looks.complaints()


@pytest.mark.slow
@pytest.mark.parametrize("page", ["index", "repository/hardware/PROTOCOL"])
def test_search_finds_words_in_pages_from_the_disk(browser, site, page):
    looks = Looks(browser)
    looks.open((site / f"{page}.html").as_uri())
    asking = browser.find_element("css selector", "input.md-search__input")
    browser.execute_script("arguments[0].focus()", asking)
    asking.send_keys("double sphere")
    found = looks.until(lambda: browser.find_elements("css selector", "a.md-search-result__link"))
    places = [link.get_attribute("href") for link in found]
    assert any(place.startswith((site / "mathematics.html").as_uri()) for place in places), places
    asked = browser.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
    assert all(name.startswith("file:") for name in asked), asked
    assert not looks.complaints()
