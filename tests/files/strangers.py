"""Clouds as other programs write them, from the documentation of their formats: each with what it must become."""

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from .e57s import made


COUNT = 400
_rng = np.random.default_rng(7)


def _box():
    """Points on the walls of a box of 4 x 3 x 2.5 m, with all its sides."""
    points = _rng.random((COUNT, 3)) * [4.0, 3.0, 2.5]
    axis, end = np.arange(COUNT) % 3, np.arange(COUNT) // 3 % 2
    points[np.arange(COUNT), axis] = end * np.array([4.0, 3.0, 2.5])[axis]
    return np.round(points - [1.5, 1.25, 1.0], 4)


XYZ = _box()
RGB = np.stack([np.where(XYZ[:, 0] > 0, 240, 40), np.full(COUNT, 128), np.where(XYZ[:, 1] > 0, 190, 40)], -1)
LEVEL = np.round(0.1 + 0.8 * (XYZ[:, 2] + 1) / 2.5, 3)
NORMAL = np.eye(3)[np.arange(COUNT) % 3] * np.where(np.arange(COUNT) // 3 % 2, -1.0, 1.0)[:, None]
WHOLE = np.clip(np.round(LEVEL * 200), 0, 255).astype(int)


class Stranger(NamedTuple):
    """A file of another program."""

    name: str
    """What it holds, and the program that writes it so."""
    suffix: str
    write: Callable[[Path], None]
    coloured: bool = True
    unit: float | None = None
    """Metres of its unit, where it states one."""
    says: str = ""
    """Words of the note, or of the refusal."""
    refused: bool = False
    intensity: np.ndarray | None = None
    normals: bool = False
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    options: tuple[str, ...] = ()


def rows(*columns, fmt="%.4f", sep=" ", comma=False):
    """Columns as lines of text; whole numbers without a point."""
    parts = []
    for column in columns:
        column = np.asarray(column)
        for one in column.T if column.ndim > 1 else [column]:
            parts.append([str(x) for x in one] if one.dtype.kind in "iuU" else [fmt % x for x in one])
    lines = [sep.join(line) for line in zip(*parts, strict=True)]
    return [line.replace(".", ",") for line in lines] if comma else lines


def text(*lines, end="\n", encoding="utf-8"):
    """A writer of lines."""
    content = end.join([line for part in lines for line in ([part] if isinstance(part, str) else part)]) + end
    return lambda path: path.write_bytes(content.encode(encoding))


def ply(properties, table, *, comments=(), order="little", before=b"", elements=()):
    """A writer of a binary PLY with the types of a structured array."""
    names = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int", "i1": "char", "u4": "uint"}
    sign = "<" if order == "little" else ">"
    packed = table.astype(np.dtype([(name, sign + table.dtype[name].str[1:]) for name in table.dtype.names]))
    lines = ["ply", f"format binary_{order}_endian 1.0", *(f"comment {one}" for one in comments), *elements]
    lines += [f"element vertex {len(table)}"]
    lines += [f"property {names[table.dtype[name].str[1:]]} {shown}" for name, shown in properties.items()]
    return lambda path: path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + before + packed.tobytes())


def table(**columns):
    """A structured array."""
    found = np.zeros(COUNT, [(name, np.asarray(value).dtype) for name, value in columns.items()])
    for name, value in columns.items():
        found[name] = value
    return found


def axes(kind, xyz=XYZ):
    return {axis: xyz[:, k].astype(kind) for k, axis in enumerate("xyz")}


def plain(names):
    return {name: name for name in names}


def pcd(fields, types, sizes, lines, *, comments=()):
    head = [*(f"# {one}" for one in comments), "VERSION .7", f"FIELDS {fields}", f"SIZE {sizes}", f"TYPE {types}"]
    head += ["COUNT " + " ".join("1" for _ in fields.split()), f"WIDTH {COUNT}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0"]
    return text([*head, f"POINTS {COUNT}", "DATA ascii"], lines)


def _floats(e57, image):
    return e57.FloatNode(image, 0.0, e57.E57_DOUBLE)


def whole(least, most):
    return lambda e57, image: e57.IntegerNode(image, least, least, most)


def scaled(least, most, scale, offset):
    return lambda e57, image: e57.ScaledIntegerNode(image, least, least, most, scale, offset)


def e57(*, xyz=XYZ, places=None, colours=RGB, limit=255, kind=None, level=None, more=(), structure=None):
    """A writer of an E57 with one scan, through libE57."""

    # The binding takes NumPy's int64 for 32 bits, not longlong.
    kinds = {"f": np.float64, "i": np.longlong}

    def write(path):
        node = kind or (lambda: _floats)
        columns = [(f"cartesian{a}", places or _floats, np.ascontiguousarray(xyz[:, k])) for k, a in enumerate("XYZ")]
        if colours is not None:
            columns += [
                (f"color{name}", node() if kind else whole(0, limit), colours[:, k].astype(kinds[colours.dtype.kind]))
                for k, name in enumerate(("Red", "Green", "Blue"))
            ]
        if level is not None:
            columns.append(("intensity", _floats, np.ascontiguousarray(level, np.float64)))
        made(path, [*columns, *more], structure=structure)

    return write


def _limits(e57, image, scan):
    limits = e57.StructureNode(image)
    for name in ("Red", "Green", "Blue"):
        limits.set(f"color{name}Minimum", e57.IntegerNode(image, 0))
        limits.set(f"color{name}Maximum", e57.IntegerNode(image, 255))
    scan.set("colorLimits", limits)


def spherical(path):
    distance = np.linalg.norm(XYZ, axis=1)
    columns = [
        ("sphericalRange", _floats, distance),
        ("sphericalAzimuth", _floats, np.arctan2(XYZ[:, 1], XYZ[:, 0])),
        ("sphericalElevation", _floats, np.arcsin(XYZ[:, 2] / distance)),
    ]
    made(path, columns)


def invalid(path):
    """Points that the scanner did not see, at 0, with their state."""
    xyz = np.concatenate([XYZ, np.zeros((50, 3))])
    state = np.repeat([0, 2], [COUNT, 50]).astype(np.longlong)
    columns = [(f"cartesian{a}", _floats, np.ascontiguousarray(xyz[:, k])) for k, a in enumerate("XYZ")]
    made(path, [*columns, ("cartesianInvalidState", whole(0, 2), state)])


def las(path, *, factor=1.0, wkt="", keys=(), doubles=(), colours=RGB * 257, height=None, version="1.4", behind=""):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=7 if version == "1.4" else 3, version=version)
    header.scales = np.full(3, 1e-5)
    if wkt:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    if keys:
        data = struct.pack("<4H", 1, 1, 0, len(keys)) + b"".join(struct.pack("<4H", *key) for key in keys)
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", data))
    if doubles:
        header.vlrs.append(laspy.VLR("LASF_Projection", 34736, "", struct.pack(f"<{len(doubles)}d", *doubles)))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y = XYZ[:, 0] / factor, XYZ[:, 1] / factor
    cloud.z = XYZ[:, 2] / (height or factor)
    if colours is not None:
        cloud.red, cloud.green, cloud.blue = colours.T.astype(np.uint16)
    if behind:
        cloud.evlrs = laspy.vlrs.vlrlist.VLRList()
        cloud.evlrs.append(laspy.VLR("LASF_Projection", 2112, "", behind.encode() + b"\0"))
    stream = io.BytesIO()
    cloud.write(stream)
    path.write_bytes(stream.getvalue())


def ptx(colours=None, level=LEVEL, blocks=1):
    """A writer of blocks of 20 columns, of one pose each."""

    def write(path):
        parts = []
        for number in range(blocks):
            some = slice(number * COUNT // blocks, (number + 1) * COUNT // blocks)
            count = COUNT // blocks
            shift = np.array([1.0 * number, 0, 0])
            head = ["20", str(count // 20), " ".join(map(str, shift)), "1 0 0", "0 1 0", "0 0 1"]
            head += ["1 0 0 0", "0 1 0 0", "0 0 1 0", " ".join(map(str, shift)) + " 1"]
            columns = [XYZ[some] - shift, level[some], *([] if colours is None else [colours[some]])]
            parts += [*head, *rows(*columns, fmt="%.6f")]
        path.write_text("\n".join(parts) + "\n")

    return write


FEET_WKT = (
    'PROJCS["NAD83 / Texas Central (ftUS)",GEOGCS["NAD83",DATUM["North_American_Datum_1983",SPHEROID["GRS 1980",'
    '6378137,298.257222101]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic_2SP"],'
    'UNIT["US survey foot",0.304800609601219,AUTHORITY["EPSG","9003"]],AXIS["X",EAST],AXIS["Y",NORTH],'
    'AUTHORITY["EPSG","2277"]]'
)
MIXED_WKT = (
    f'COMPD_CS["map and heights",{FEET_WKT},VERT_CS["NAVD88",VERT_DATUM["NAVD88",2005],UNIT["metre",1],AXIS["Up",UP]]]'
)
WKT2 = (
    'PROJCRS["site",BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",ELLIPSOID["WGS 84",6378137,298.257223563,'
    'LENGTHUNIT["metre",1]]]],CONVERSION["c",METHOD["Transverse Mercator"]],CS[Cartesian,2],'
    'AXIS["(E)",east,ORDER[1],LENGTHUNIT["foot",0.3048]],AXIS["(N)",north,ORDER[2],LENGTHUNIT["foot",0.3048]]]'
)
US_FOOT = 1200 / 3937
NUMBER = np.arange(1, COUNT + 1)
PACKED = (RGB[:, 0] << 16 | RGB[:, 1] << 8 | RGB[:, 2]).astype(np.uint32)
NAMES = [f"P{k}" for k in NUMBER]
WITH_LEVEL, COLOUR_NAMES = rows(XYZ, WHOLE - 100, RGB), ("red", "green", "blue")
MILLI, PLAIN = 1e-3, {"coloured": False}


def coloured_ply(kind, names=COLOUR_NAMES, colours=RGB, axis="f4", **more):
    """A PLY with colours of a type, in properties of these names."""
    columns = {name: colours[:, k].astype(kind[-2:]) for k, name in enumerate(COLOUR_NAMES)}
    return ply(plain("xyz") | dict(zip(COLOUR_NAMES, names, strict=True)), table(**axes(axis), **columns), **more)


def las_in(unit=US_FOOT, **more):
    """A LAS in a unit."""
    return lambda path: las(path, factor=unit, **more)


def keyed(*keys, unit=1.0, **more):
    """A LAS of before 1.4 with GeoKeys."""
    return las_in(unit, keys=[(1024, 0, 1, 1), *keys], version="1.2", **more)


TEXTS = [
    Stranger("pts: Leica Cyclone", ".pts", text(str(COUNT), WITH_LEVEL), intensity=WHOLE - 100.0),
    Stranger("pts 8 bit: Leica", ".pts", text(str(COUNT), rows(XYZ, WHOLE, RGB)), intensity=WHOLE.astype(float)),
    Stranger(
        "pts of two scans: Leica Cyclone",
        ".pts",
        text("150", WITH_LEVEL[:150], str(COUNT - 150), WITH_LEVEL[150:]),
        says="2 scans",
        intensity=WHOLE - 100.0,
    ),
    Stranger(
        "pts with more points: another number in the first line",
        ".pts",
        text(str(COUNT - 100), WITH_LEVEL),
        says="scan 1 says that it has 300 points, and has 400: all are read",
        intensity=WHOLE - 100.0,
    ),
    Stranger("faro: FARO Scene, xyz", ".xyz", text(rows(XYZ, RGB)), says="by their numbers"),
    Stranger(
        "irgb listed: four whole numbers",
        ".xyz",
        text(rows(XYZ, WHOLE, RGB)),
        options=("--columns", "x,y,z,i,r,g,b"),
        intensity=WHOLE.astype(float),
        says="by --columns",
    ),
    Stranger(
        "cloudcompare: CloudCompare ASCII with heading and number of points",
        ".asc",
        text(
            "//X Y Z Rf Gf Bf Original cloud index Nx Ny Nz",
            str(COUNT),
            rows(XYZ, RGB / 255, np.zeros(COUNT), NORMAL, fmt="%.6f"),
        ),
        says="not used: Original cloud index",
        normals=True,
    ),
    Stranger(
        "excel: spreadsheet with quotes and decimal commas",
        ".csv",
        text('"X [mm]";"Y [mm]";"Z [mm]";"R";"G";"B"', rows(XYZ * 1000, RGB, sep=";", comma=True), end="\r\n"),
        unit=MILLI,
        says="millimetres by the names of its columns",
    ),
    Stranger("tab and comma", ".txt", text(rows(XYZ, sep="\t", comma=True)), says="commas are decimal", **PLAIN),
    Stranger("blank and comma", ".txt", text("x y z", rows(XYZ, sep=" ", comma=True)), **PLAIN),
    Stranger(
        "comma and comma with a blank: commas for both, blanks between columns",
        ".txt",
        text([line.replace(";", ", ") for line in rows(XYZ, RGB, sep=";", comma=True)]),
        says="commas are decimal",
    ),
    Stranger(
        "scans behind headings: heading before each scan",
        ".txt",
        text(*[["X Y Z R G B", "100", *rows(XYZ, RGB)[k : k + 100]] for k in range(0, COUNT, 100)]),
        says="4 scans",
    ),
    Stranger(
        "whole millimetres: whole numbers and commas",
        ".csv",
        text("x_mm,y_mm,z_mm", rows(np.round(XYZ * 1e4).astype(int), sep=",")),
        unit=MILLI,
        offset=(np.nan, np.nan, np.nan),
        **PLAIN,
    ),
    Stranger(
        "pnezd: Trimble, point, northing, easting, elevation, code",
        ".csv",
        text(
            "Point,Northing,Easting,Elevation,Code",
            rows(np.array(NAMES), XYZ[:, [1, 0, 2]], np.array(["WALL"] * COUNT), sep=","),
        ),
        says="not used: Point, Code",
        **PLAIN,
    ),
    Stranger(
        "german survey: heading in German, UTF-8 with mark",
        ".txt",
        text("\ufeffPunktnr;Rechtswert;Hochwert;Höhe", rows(NUMBER, XYZ, sep=";", comma=True)),
        says="not used: Punktnr",
        **PLAIN,
    ),
    Stranger("counted: point number, no heading", ".txt", text(rows(NUMBER, XYZ, RGB)), says="not used: column 1"),
    Stranger("realitycapture: RealityCapture xyz, commas", ".xyz", text("#x,y,z,r,g,b", rows(XYZ, RGB, sep=","))),
    Stranger("agisoft: Agisoft Metashape, colours and normals", ".txt", text(rows(XYZ, RGB, NORMAL)), normals=True),
    Stranger("meshlab xyz: MeshLab, normals", ".xyz", text(rows(XYZ, NORMAL)), normals=True, **PLAIN),
    Stranger(
        "pointools: Bentley Pointools, intensity between",
        ".txt",
        text("X\tY\tZ\tIntensity\tR\tG\tB", rows(XYZ, LEVEL, RGB, sep="\t")),
        intensity=LEVEL,
    ),
    Stranger(
        "riegl: RIEGL RiSCAN, blanks before numbers",
        ".asc",
        text("X[m] Y[m] Z[m] Amplitude[dB]", ["  " + line for line in rows(XYZ, LEVEL, sep="   ")]),
        unit=1.0,
        intensity=LEVEL,
        **PLAIN,
    ),
    Stranger(
        "units in a comment: Polyworks",
        ".txt",
        text("# PolyWorks points", "# Units: millimeters", rows(XYZ * 1000)),
        unit=MILLI,
        says="millimetres by the comment",
        **PLAIN,
    ),
    Stranger(
        "units against each other: two comments",
        ".txt",
        text("# units: mm", "# units: inch", rows(XYZ)),
        says="its comments name several units",
        **PLAIN,
    ),
]
REFUSED = [
    Stranger(name, suffix, write, says=says, refused=True)
    for name, suffix, write, says in (
        (
            "pts cut short: Leica Cyclone",
            ".pts",
            text(str(COUNT), WITH_LEVEL[:-1]),
            "says that it has 400 points, and has 399",
        ),
        ("irgb or rgbi: four whole numbers", ".xyz", text(rows(XYZ, WHOLE, RGB)), "jaxscan convert --columns x,y,z,"),
        (
            "comma and comma: commas for both",
            ".csv",
            text(rows(np.abs(XYZ) % 1 + 1.0001, sep=",", comma=True)),
            "commas are both decimal and between columns",
        ),
        (
            "comma and comma with colours: commas for both",
            ".csv",
            text([line.replace(";", ",") for line in rows(XYZ, RGB, sep=";", comma=True)]),
            "commas are both decimal and between columns",
        ),
        ("thousands: points between thousands", ".txt", text(["1.234,5;2.345,6;3.456,7"] * 5), "group thousands"),
        ("latitude", ".csv", text("Lat,Lon,Height", rows(XYZ, sep=",")), "degrees of latitude and longitude"),
        ("strange heading", ".csv", text("alpha,beta,gamma", rows(XYZ, sep=",")), "--columns"),
        ("utf-16: text of a Windows program", ".txt", text(rows(XYZ), encoding="utf-16"), "UTF-16"),
        (
            "las degrees: GeoKeys of degrees",
            ".las",
            las_in(1.0, keys=[(1024, 0, 1, 2), (2048, 0, 1, 4326)], version="1.2"),
            "degrees of longitude and latitude",
        ),
    )
]
TABLES = [
    Stranger("ply pdal: ushort of 0 to 255", ".ply", coloured_ply("u2", axis="f8"), says="by the largest, 240"),
    Stranger("ply float 255: floats of 0 to 255", ".ply", coloured_ply("f4"), says="colours 0 to 255"),
    Stranger(
        "ply short names: r, g, b as floats of 0 to 1",
        ".ply",
        coloured_ply("f4", "rgb", RGB / 255, order="big"),
        says="colours 0 to 1",
    ),
    Stranger("ply diffuse: MeshLab of old", ".ply", coloured_ply("u1", [f"diffuse_{one}" for one in COLOUR_NAMES])),
    Stranger("ply char: colours as signed bytes", ".ply", coloured_ply("i1", colours=RGB.astype("u1").view("i1"))),
    Stranger(
        "ply in millimetres: a desk scanner, unit in obj_info",
        ".ply",
        ply(plain("xyz"), table(**axes("f4", XYZ * 1000)), comments=("Scanned with X", "unit: millimeter")),
        unit=MILLI,
        **PLAIN,
    ),
    Stranger(
        "ply sigma: a field sigma without prefix",
        ".ply",
        ply(plain(("x", "y", "z", "sigma")), table(**axes("f4"), sigma=np.full(COUNT, 0.002, "f4"))),
        **PLAIN,
    ),
    Stranger(
        "ply faces first: faces of several lengths before the vertices",
        ".ply",
        ply(
            plain("xyz"),
            table(**axes("f4")),
            elements=("element face 3", "property list uchar int vertex_indices"),
            before=struct.pack("<B3iB4iB3i", 3, 0, 1, 2, 4, 0, 1, 2, 3, 3, 1, 2, 3),
        ),
        **PLAIN,
    ),
    *(
        Stranger(f"pcd rgb: colour {name}", ".pcd", pcd("x y z rgb", f"F F F {kind}", "4 4 4 4", rows(XYZ, colour)))
        for name, kind, colour in (
            ("packed into a float", "F", [f"{x:.9g}" for x in PACKED.view("f4")]),
            ("as the packed number in a float", "F", [f"{x}.0" for x in PACKED]),
            ("packed into a whole number", "U", PACKED),
        )
    ),
    Stranger(
        "pcd r g b: three fields",
        ".pcd",
        pcd("x y z r g b intensity", "F F F U U U F", "4 4 4 1 1 1 4", rows(XYZ, RGB, LEVEL)),
        intensity=LEVEL,
    ),
    Stranger(
        "pcd floats: three floats of 0 to 1",
        ".pcd",
        pcd("x y z r g b", "F F F F F F", "4 4 4 4 4 4", rows(XYZ, RGB / 255, fmt="%.6f")),
        says="colours 0 to 1",
    ),
    Stranger("las: 16 bits", ".las", las, says="the file does not say its unit"),
    Stranger("las 8 bits: 8 bits in 16", ".las", las_in(1.0, colours=RGB), says="colours 0 to 255"),
    Stranger("las without colours: zeros", ".las", las_in(1.0, colours=RGB * 0), **PLAIN),
    Stranger("las feet: WKT in US survey feet", ".las", las_in(wkt=FEET_WKT), unit=US_FOOT),
    Stranger("las mixed", ".las", las_in(wkt=MIXED_WKT, height=1.0), unit=US_FOOT, says="heights in metres"),
    Stranger("las wkt2: WKT of version 2 in feet", ".las", las_in(0.3048, wkt=WKT2), unit=0.3048),
    Stranger(
        "las unknown wkt: WKT without a projection",
        ".las",
        las_in(1.0, wkt='PROJCS["site",UNIT["foot",0.3048]]'),
        says="its WKT states no unit that is known",
    ),
    Stranger("las behind: WKT behind the points", ".las", las_in(behind=FEET_WKT), unit=US_FOOT),
    Stranger("las keys: GeoKeys in feet", ".las", keyed((3076, 0, 1, 9002), unit=0.3048), unit=0.3048),
    Stranger("las map of keys: in US survey feet", ".las", keyed((3072, 0, 1, 2277), unit=US_FOOT), unit=US_FOOT),
    Stranger(
        "las size of a unit: GeoKeys with the ellipsoid and the size of a unit as doubles",
        ".las",
        keyed(
            *[(2057, 34736, 1, 0), (3076, 0, 1, 32767), (3077, 34736, 1, 1)], unit=US_FOOT, doubles=(6378137.0, US_FOOT)
        ),
        unit=US_FOOT,
    ),
]
GRID = [
    ("rowIndex", whole(0, COUNT), (np.arange(COUNT) % 20).astype(np.longlong)),
    ("columnIndex", whole(0, COUNT), (np.arange(COUNT) // 20).astype(np.longlong)),
    ("timeStamp", _floats, np.arange(COUNT, dtype=np.float64)),
]
# Both formats are in metres.
SCANS = [
    Stranger(name, suffix, write, unit=1.0, **more)
    for name, suffix, write, more in (
        ("ptx: Leica, four numbers a line", ".ptx", ptx(), PLAIN | {"intensity": 255 * LEVEL}),
        ("ptx colours: Leica", ".ptx", ptx(RGB), {"intensity": 255 * LEVEL}),
        ("ptx of two scans: Leica", ".ptx", ptx(RGB, blocks=2), {}),
        ("ptx floats: colours of 0 to 1", ".ptx", ptx(RGB / 255.0), {"says": "colours 0 to 1"}),
        ("e57: libE57, 8 bits", ".e57", e57(level=LEVEL), {"intensity": LEVEL}),
        ("e57 xyz: libE57, places alone", ".e57", e57(colours=None), PLAIN),
        ("e57 16 bits: colours of 16 bits without limits", ".e57", e57(colours=RGB * 257, limit=65535), {}),
        (
            "e57 8 in 16 bits: colours of 8 bits in a field of 16",
            ".e57",
            e57(limit=65535),
            {"says": "colours 0 to 255 by the largest, 240, not the 65535"},
        ),
        (
            "e57 limits of 8 bits: limits of 8 bits, colours of 16",
            ".e57",
            e57(colours=RGB * 257, limit=65535, structure=_limits),
            {"says": "not the 255 that the file states"},
        ),
        ("e57 floats: colours of 0 to 1", ".e57", e57(colours=RGB / 255.0, kind=lambda: _floats), {}),
        ("e57 scaled: Autodesk ReCap, with an offset", ".e57", e57(places=scaled(-60_000, 60_000, 1e-4, 1.0)), {}),
        ("e57 spherical: FARO, ranges and angles", ".e57", spherical, PLAIN),
        ("e57 invalid: points that were not seen", ".e57", invalid, PLAIN),
        ("e57 grid: Leica BLK, rows and columns", ".e57", e57(more=GRID), {"says": "not used: timeStamp"}),
        (
            "e57 in millimetres: a program that writes millimetres",
            ".e57",
            e57(xyz=XYZ * 1000, colours=None),
            PLAIN | {"offset": (np.nan, np.nan, np.nan), "says": "in millimetres it would be"},
        ),
    )
]
STRANGERS = [*TEXTS, *REFUSED, *TABLES, *SCANS]
