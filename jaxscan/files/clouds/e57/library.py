"""The binding of libE57 in pye57, and the names of our extension."""

from typing import Any

from jaxscan.errors import DependencyError


NORMALS_URI = "http://www.libe57.org/E57_EXT_surface_normals.txt"
"""Namespace of the normals `nor:normalX` and so on, an extension that other programs know."""
OWN_URI = "https://jaxscan.invalid/e57"
"""Namespace of ours: `jaxscan:header`, the lines of a header, and values of points by the names of their columns."""
OWN = "jaxscan:"
COLUMNS = {
    "cartesianX": "x",
    "cartesianY": "y",
    "cartesianZ": "z",
    "intensity": "intensity",
    "colorRed": "red",
    "colorGreen": "green",
    "colorBlue": "blue",
    "rowIndex": "row",
    "columnIndex": "step",
    "nor:normalX": "nx",
    "nor:normalY": "ny",
    "nor:normalZ": "nz",
}
"""Columns that the standard and the extension of normals know."""


def load_libe57() -> Any:
    """The module.

    Raises:
        DependencyError: If pye57 is not installed.
    """
    try:
        import pye57
    except ImportError as problem:
        raise DependencyError('E57 needs pye57: pip install "jaxscan[export]"') from problem
    return pye57.libe57
