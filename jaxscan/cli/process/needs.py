"""Packages that a verb cannot do without."""

from importlib.util import find_spec

from jaxscan.errors import DependencyError


def need_pages(what: str, extra: str) -> None:
    """Check that pages can be served.

    Args:
        what: What needs them, as the beginning of a sentence.
        extra: The package's extra that brings what is missing.

    Raises:
        DependencyError: If aiohttp is not installed.
    """
    if find_spec("aiohttp") is None:
        raise DependencyError(f"{what} needs aiohttp; type: pip install 'jaxscan[{extra}]'")
