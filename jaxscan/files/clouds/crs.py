"""Coordinate reference systems by their EPSG code, through pyproj; and that of a scanner, which is nowhere on Earth."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from jaxscan.errors import CloudError, DependencyError


LOCAL_WKT = (
    'LOCAL_CS["jaxscan, frame of the {frame}",LOCAL_DATUM["jaxscan",32767],UNIT["metre",1,AUTHORITY["EPSG","9001"]],'
    'AXIS["x",OTHER],AXIS["y",OTHER],AXIS["z",UP]]'
)
"""OGC WKT of a frame in metres with z up."""

_CODE_AT_END = re.compile(r'(?:AUTHORITY\["EPSG","(\d{1,6})"\]|ID\["EPSG",(\d{1,6})\])\s*\]\s*\Z')
_TOKEN = re.compile(
    r'"((?:[^"]|"")*)"|([A-Za-z_][A-Za-z_0-9]*)|([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)|([\[\](),])', re.ASCII
)
_FLAT = {"PROJCS", "PROJCRS", "PROJECTEDCRS", "LOCAL_CS", "ENGCRS", "ENGINEERINGCRS", "GEOCCS", "BOUNDCRS"}
_GLOBE = {"GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS"}
_HEIGHTS = {"VERT_CS", "VERTCRS", "VERTICALCRS", "VERTCS"}
_UNITS_OF_LENGTH = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9036: 1000.0, 9030: 1852.0, 9096: 0.9144}
"""Metres of units by their EPSG codes, as GeoTIFF names them."""
_LONGEST_WKT, _DEEPEST = 1 << 20, 8
_MODEL, _PROJECTED, _LENGTH_UNIT, _LENGTH_SIZE, _HEIGHT_UNIT = 1024, 3072, 3076, 3077, 4099
_BY_USER = 32767


def wkt_of(epsg: int) -> str:
    """OGC WKT of a reference system whose coordinates are metres.

    Raises:
        CloudError: If there is none with this code, or its coordinates are no metres.
        DependencyError: If pyproj is not installed.
    """
    try:
        import pyproj
    except ImportError as problem:
        raise DependencyError('An EPSG code needs pyproj: pip install "jaxscan[export]"') from problem
    try:
        crs = pyproj.CRS.from_epsg(epsg)
    except pyproj.exceptions.CRSError as problem:
        raise CloudError(f"EPSG:{epsg}: no coordinate reference system has this code.") from problem
    factors = {axis.unit_conversion_factor for axis in crs.axis_info}
    if not (crs.is_projected and factors == {1.0}):
        raise CloudError(
            f"EPSG:{epsg}: is {crs.name}, whose coordinates are not metres on a map; choose a projected one in metres, "
            "such as that of a UTM zone (EPSG:25832)."
        )
    text: str = crs.to_wkt("WKT1_GDAL")
    return text


def epsg_of(wkt: str) -> int | None:
    """The code that a WKT names for the whole system; None where it names none."""
    found = _CODE_AT_END.search(wkt.strip("\0 \n"))
    return int(found[1] or found[2]) if found else None


class Frame(NamedTuple):
    """What a file says of the coordinates of its reference system."""

    metres: tuple[float, float, float] | None = None
    """Metres of a unit of x, y and z; None where it is not stated."""
    in_degrees: bool = False
    """Whether x and y are degrees."""


def frame_of_wkt(wkt: str) -> Frame:
    """Units of a WKT, of version 1 or 2: that of the map, and that of the heights where they have their own."""
    nodes = _nodes(wkt)
    flat = _unit_below(nodes, _FLAT)
    if flat is None:
        return Frame(in_degrees=bool(nodes) and any(name in _GLOBE for name, _, _ in nodes))
    heights = _unit_below(nodes, _HEIGHTS) or flat
    return Frame((flat, flat, heights))


def frame_of_keys(keys: Mapping[int, int], sizes: Mapping[int, float]) -> Frame:
    """Units of the keys of a GeoTIFF, which LAS files of before 1.4 hold.

    Args:
        keys: Values by the numbers of the keys.
        sizes: Those that are not whole numbers.
    """
    if keys.get(_MODEL) == 2:
        return Frame(in_degrees=True)
    code = keys.get(_LENGTH_UNIT)
    flat = sizes.get(_LENGTH_SIZE) if code == _BY_USER else _UNITS_OF_LENGTH.get(code or 0)
    if flat is None and 0 < keys.get(_PROJECTED, 0) < _BY_USER:
        flat = _unit_of_code(keys[_PROJECTED])
    if flat is None or not flat > 0:
        return Frame()
    return Frame((flat, flat, _UNITS_OF_LENGTH.get(keys.get(_HEIGHT_UNIT, 0), flat)))


def epsg_of_keys(keys: Mapping[int, int]) -> int | None:
    """The code of the map that the keys of a GeoTIFF name."""
    code = keys.get(_PROJECTED, 0)
    return code if 1024 <= code < _BY_USER else None


def _unit_of_code(epsg: int) -> float | None:
    """Metres of a unit of a map; None where nobody knows it."""
    try:
        import pyproj

        factors = {axis.unit_conversion_factor for axis in pyproj.CRS.from_epsg(epsg).axis_info[:2]}
    except ImportError:
        return None
    except pyproj.exceptions.CRSError:
        return None
    return float(factors.pop()) if len(factors) == 1 else None


_Node = tuple[str, tuple[str, ...], list[str]]
"""Keyword, keywords of the nodes around it, and the texts and numbers directly in it."""


def _nodes(wkt: str) -> list[_Node]:
    """All nodes of a WKT, in the order in which they begin."""
    found: list[_Node] = []
    open_: list[_Node] = []
    word = ""
    for match in _TOKEN.finditer(wkt[:_LONGEST_WKT]):
        text, name, number, sign = match.groups()
        if name is not None:
            word = name.upper()
        elif sign in ("[", "("):
            node: _Node = (word, tuple(each[0] for each in open_[-_DEEPEST:]), [])
            found.append(node)
            open_.append(node)
        elif sign in ("]", ")"):
            if open_:
                open_.pop()
        elif sign is None and open_:
            open_[-1][2].append(text if text is not None else number)
    return found


def _unit_below(nodes: list[_Node], kinds: set[str]) -> float | None:
    """Metres of the unit of the first node of some kinds: its own, or that of its axes."""
    for name, around, values in nodes:
        own = around[-1:] and around[-1] in kinds
        of_axis = len(around) > 1 and around[-1] == "AXIS" and around[-2] in kinds
        if name in ("UNIT", "LENGTHUNIT") and (own or of_axis) and len(values) > 1:
            try:
                factor = float(values[1])
            except ValueError:
                continue
            if 1e-6 < factor < 1e6:
                return factor
    return None
