"""Coordinate reference systems by their EPSG code, through pyproj; and that of a scanner, which is nowhere on Earth."""

import re

from jaxscan.errors import CloudError, DependencyError


LOCAL_WKT = (
    'LOCAL_CS["jaxscan, frame of the {frame}",LOCAL_DATUM["jaxscan",32767],UNIT["metre",1,AUTHORITY["EPSG","9001"]],'
    'AXIS["x",OTHER],AXIS["y",OTHER],AXIS["z",UP]]'
)
"""OGC WKT of a frame in metres with z up."""

_CODE_AT_END = re.compile(r'(?:AUTHORITY\["EPSG","(\d{1,6})"\]|ID\["EPSG",(\d{1,6})\])\s*\]\s*\Z')
_UNITS = re.compile(r'\b(?:LENGTH)?UNIT\["([^"]{1,40})"', re.ASCII)
_METRE, _ANGLES = {"metre", "meter", "m"}, {"degree", "radian", "grad", "unity"}


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


def is_in_metres(wkt: str) -> bool:
    """Whether all lengths of a WKT are metres; its map or heights may be in feet."""
    units = {unit.lower() for unit in _UNITS.findall(wkt)} - _ANGLES
    return bool(units) and units <= _METRE
