"""laspy, and lazrs for compressed files."""

from typing import Any

from jaxscan.errors import DependencyError


def load_laspy(*, compressed: bool) -> Any:
    """The module.

    Raises:
        DependencyError: If laspy, or lazrs where it is needed, is not installed.
    """
    missing = DependencyError('LAS and LAZ need laspy and lazrs: pip install "jaxscan[export]"')
    try:
        import laspy
    except ImportError as problem:
        raise missing from problem
    if compressed and not laspy.LazBackend.detect_available():
        raise missing
    return laspy
