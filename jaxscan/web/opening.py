"""Opening a page in the browser of this machine."""

import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path


_PAGE = """<!doctype html>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={url}">
<title>jaxscan</title>
<a href="{url}">jaxscan</a>
"""


@contextmanager
def in_browser(url: str) -> Iterator[None]:
    """Open an address with its token in a new tab; within `with`, as a browser may take its time to begin.

    Every account of this machine sees the words with which a program is called. So the browser is called with a file
    that this account alone can read, and that leads on to the address.
    """
    with tempfile.TemporaryDirectory(prefix="jaxscan-") as folder:
        page = Path(folder) / "open.html"
        page.touch(0o600, exist_ok=False)
        page.write_text(_PAGE.format(url=escape(url)), encoding="utf-8")
        webbrowser.open_new_tab(page.as_uri())
        yield
