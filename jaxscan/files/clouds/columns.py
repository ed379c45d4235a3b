"""What the columns of a cloud's file are, which number is full brightness, and which unit is stated: for every format.

A table of this library says all that by its names. In those of other programs the same things have many names, colours
have many ranges, and text often has no names at all. Every decision is reported with its evidence, and a `Reading`,
which a person gives, overrules it. What cannot be decided is refused with the columns that were found.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.header import StoredCloud, about_of, version_of
from jaxscan.files.clouds.points import USED, Records, cloud_of


AXES, COLOURS, NORMALS = ("x", "y", "z"), ("red", "green", "blue"), ("nx", "ny", "nz")
Unit = Literal["m", "cm", "mm", "inch", "foot", "us-foot"]
METRES: dict[Unit, float] = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "inch": 0.0254,
    "foot": 0.3048,
    "us-foot": 1200 / 3937,
}
UNIT_WORDS: dict[Unit, str] = {
    "m": "metres",
    "cm": "centimetres",
    "mm": "millimetres",
    "inch": "inches",
    "foot": "feet",
    "us-foot": "US survey feet",
}
SHORT_NAMES = {"i": "intensity", "r": "red", "g": "green", "b": "blue"}
UNUSED = "-"


class Reading(NamedTuple):
    """Columns and colours that a person states for a file."""

    columns: tuple[str, ...] | None = None
    """Names of its columns from the first on, of `USED` or `UNUSED`."""
    brightest: float | None = None
    """The number of full brightness of its colours; 0 where they are none."""


def parse_columns(text: str) -> tuple[str, ...]:
    """Names of columns as a person lists them, such as `x,y,z,i,r,g,b`.

    Raises:
        ValueError: If a name is unknown or there twice, or x, y or z is missing.
    """
    names = [word.strip().lower() for word in text.split(",")]
    found = [UNUSED if name in ("", UNUSED, "_") else SHORT_NAMES.get(name, name) for name in names]
    named = [name for name in found if name != UNUSED]
    known = (*AXES, "i", "r", "g", "b", *NORMALS, "sigma_random", "sigma_systematic")
    if unknown := next((name for name in named if name not in USED), None):
        raise ValueError(f'found "{unknown}", expected names of {", ".join(known)}, and - for a column to leave out')
    if len(set(named)) < len(named) or not set(AXES) <= set(named):
        raise ValueError("expected x, y and z, and no name twice")
    return tuple(found)


# --- names

_NAMES: dict[str, tuple[str, ...]] = {
    "x": ("x", "coordx", "xcoord", "xcoordinate", "coordinatex", "posx", "positionx", "xpos", "pointx", "cartesianx"),
    "red": ("red", "r", "rf", "diffusered", "colorred", "colourred", "redcolor", "rot", "rouge", "vertexred"),
    "green": ("green", "g", "gf", "diffusegreen", "colorgreen", "colourgreen", "greencolor", "grün", "vert"),
    "blue": ("blue", "b", "bf", "diffuseblue", "colorblue", "colourblue", "bluecolor", "blau", "bleu", "vertexblue"),
    "intensity": ("intensity", "i", "reflectance", "reflectivity", "amplitude", "intensität", "intensité", "remission"),
    "nx": ("nx", "normalx", "normx", "xnormal", "nxx"),
    "sigma": ("sigma", "stddev", "standarddeviation"),
}
_NAMES |= {axis: tuple(name.replace("x", axis) for name in _NAMES["x"]) for axis in "yz"} | {
    f"n{axis}": (f"n{axis}", f"normal{axis}", f"norm{axis}", f"{axis}normal", f"n{axis}{axis}") for axis in "yz"
}
_MAP_NAMES: dict[str, tuple[str, ...]] = {
    "x": ("easting", "east", "eastings", "e", "rechtswert", "ostwert", "eastingx", "xeasting"),
    "y": ("northing", "north", "northings", "n", "hochwert", "nordwert", "northingy", "ynorthing"),
    "z": ("elevation", "elev", "height", "h", "altitude", "alt", "höhe", "hoehe", "zelevation", "quota", "level"),
}
"""Names of surveys, where a file has no x, y or z."""
_PLAIN = {name: plain for plain, names in _NAMES.items() for name in names}
_ON_MAP = {name: plain for plain, names in _MAP_NAMES.items() for name in names}
_GLOBE = {"latitude", "lat", "longitude", "lon", "long", "lng", "breite", "länge"}
_UNIT_OF_NAME = re.compile(r"\s*[\[(]\s*([^\])]{1,12})\s*[\])]\s*$")
_UNIT_AT_END = re.compile(r"(?<=[xyz])_(mm|cm|m|ft|in)$")


def _bare(name: str) -> str:
    """A name without prefix, unit, and what programs put between words."""
    name = name.strip().strip("\"'").lower().removeprefix("scalar_")
    name = _UNIT_AT_END.sub("", _UNIT_OF_NAME.sub("", name) or name)
    return re.sub(r"[\W_]", "", name) or name


def plain_of(name: str) -> str | None:
    """The name of a column as a cloud has it; None where it is not known."""
    if name in USED or name == "sigma":
        return name
    bare = name.strip().lower().removeprefix("scalar_")
    return bare if bare in USED else _PLAIN.get(_bare(name))


def is_known(name: str) -> bool:
    """Whether a word is the name of a column in any program."""
    return plain_of(name) is not None or _bare(name) in _ON_MAP or _bare(name) in _GLOBE


class Columns(NamedTuple):
    """Which column of a table is which."""

    places: dict[str, int]
    """Places of the columns of a cloud, by their names in `USED`."""
    unused: tuple[str, ...]
    unit: Unit | None = None


def assign(names: Sequence[str], *, what: str = "the columns", ours: bool = False) -> Columns:
    """Find the columns of a cloud by their names, which are empty where a column has none.

    Args:
        what: The names, for messages.
        ours: Whether this library wrote the file.
    """
    places: dict[str, int] = {}

    def take(plain: str | None, k: int) -> None:
        if plain is not None and plain not in places and k not in places.values():
            places[plain] = k

    plains = [plain_of(name) for name in names]
    # A column that has its name to the letter comes before one that has it in other words, and that before a survey's.
    for exact in (True, False):
        for k, (name, plain) in enumerate(zip(names, plains, strict=True)):
            if plain == name or not exact:
                take(plain, k)
    for k, name in enumerate(names):
        take(_ON_MAP.get(_bare(name)), k)
    if not set(AXES) <= places.keys():
        found = ", ".join(name or "?" for name in names)
        if {_bare(name) for name in names} & _GLOBE:
            raise CloudError(
                f"{what} are degrees of latitude and longitude ({found:.60}), expected lengths; project them onto a "
                "map first."
            )
        raise CloudError(
            f"{what} ({found:.60}) are no x, y and z; name them in their order with jaxscan convert --columns "
            "x,y,z,i,r,g,b."
        )
    units = {stated_of(names[places[axis]]) for axis in AXES}
    return _columns(names, places if ours else _complete(places), units.pop() if len(units) == 1 else None)


def _columns(names: Sequence[str], places: dict[str, int], unit: Unit | None = None) -> Columns:
    return Columns(places, tuple(name for k, name in enumerate(names) if k not in places.values()), unit)


def _complete(places: dict[str, int]) -> dict[str, int]:
    """Places without parts of colours and normals, and with one sigma as that of the noise."""
    parts = [part for whole in (COLOURS, NORMALS) if not set(whole) <= places.keys() for part in whole]
    kept = {name: k for name, k in places.items() if name not in (*parts, "sigma")}
    if "sigma" in places and not {"sigma_random", "sigma_systematic"} & kept.keys():
        kept["sigma_random"] = places["sigma"]
    return kept


def listed(names: Sequence[str], wanted: Sequence[str]) -> Columns:
    """The columns of a file with these names, as a person lists them."""
    if len(wanted) > len(names):
        raise CloudError(f"has {len(names)} columns, and --columns lists {len(wanted)}.")
    return _columns(names, _complete({name: k for k, name in enumerate(wanted) if name != UNUSED}))


def plain_names(names: Iterable[str]) -> list[str]:
    """The names of columns as a cloud has them, each once; those that are not known stay."""
    given = list(names)
    taken = {name for name in given if name in USED or name == "sigma"}
    found = []
    for name in given:
        plain = plain_of(name)
        fits = plain is not None and plain != name and plain not in taken
        taken |= {plain} if fits and plain else set()
        found.append(plain if fits and plain else name)
    return found


# --- tables without names


class Extent(NamedTuple):
    """Statistics of each column of a table [width], over all rows."""

    least: np.ndarray
    most: np.ndarray
    whole: np.ndarray
    unit: np.ndarray
    counts: bool
    """Whether the first column counts the rows."""

    @staticmethod
    def of(table: np.ndarray) -> "Extent":
        """The statistics of some rows [n, width]."""
        width = table.shape[1]
        unit = np.zeros(width, bool)
        squares = table**2
        for k in range(3, width - 2):
            unit[k] = bool((np.abs(np.sqrt(squares[:, k : k + 3].sum(1)) - 1) < 0.01).all())
        whole = ((table == np.floor(table)) | np.isnan(table)).all(0)
        counts = bool((np.diff(table[:, 0]) == 1).all())
        return Extent(np.fmin.reduce(table), np.fmax.reduce(table), whole, unit, counts)

    def colours(self, columns: Columns) -> "Reach | None":
        """The range of the colours; None without colours."""
        if not set(COLOURS) <= columns.places.keys():
            return None
        at = [columns.places[name] for name in COLOURS]
        return Reach(float(np.nan_to_num(self.most[at]).max()), bool(self.whole[at].all()))

    def with_more(self, other: "Extent") -> "Extent":
        """The statistics of these rows and those of `other`, which follow them in the file."""
        follows = self.counts and other.counts and other.least[0] == self.most[0] + 1
        return Extent(
            np.fmin(self.least, other.least),
            np.fmax(self.most, other.most),
            self.whole & other.whole,
            self.unit & other.unit,
            bool(follows),
        )


_PIECES = {"c": COLOURS, "n": NORMALS, "i": ("intensity",)}


def guessed(extent: Extent, *, points: int, counted: bool) -> Columns:
    """Find the columns of a table without names by their numbers.

    x, y and z come first, or after numbers that count the points. Three whole numbers of 0 to 255, or three of 0 to 1,
    are a colour; three that are a unit vector a normal; and one that is left over is the intensity.

    Args:
        extent: Statistics of the columns.
        points: Number of points.
        counted: Whether their number stands before them, as in a file of Leica's, where intensity comes before colours.
    """
    width = len(extent.least)
    start = 1 if width >= 4 and extent.counts and points >= 3 else 0
    fitting: dict[str, int] = {}
    for order in ("".join(one) for count in range(4) for one in itertools.permutations("cni", count)):
        at = _places_of(order, start)
        if at[-1] > width or not all(_fits(piece, k, extent) for piece, k in zip(order, at, strict=False)):
            continue
        # A single number is the intensity where it is the only one that is left.
        if "i" not in order or at[-1] == width:
            fitting[order] = at[-1] - ("i" in order)
    ways = [way for way, covered in fitting.items() if covered == max(fitting.values())]
    ways = [way for way in ways if len(way) == max(map(len, ways))]
    if counted and len(ways) > 1:
        ways = [way for way in ways if way.startswith("ic")] or ways
    opaque = [way for way in ways if way.endswith("ci") and _is_opaque(_places_of(way, start)[-2], extent)]
    if len(ways) > 1 and opaque:
        ways = [opaque[0][:-1]]
    if len(ways) > 1:
        texts = [",".join(_short(way, start)) for way in ways[:2]]
        raise CloudError(
            f"its {width} columns have no names, and several ways to read them fit; say it with jaxscan convert "
            f"--columns {texts[0]} or {texts[1]}."
        )
    places = {axis: start + k for k, axis in enumerate(AXES)}
    for piece, begin in zip(ways[0], _places_of(ways[0], start), strict=False):
        places |= {name: begin + k for k, name in enumerate(_PIECES[piece])}
    return _columns([f"column {k + 1}" for k in range(width)], places)


def _places_of(order: str, start: int) -> list[int]:
    """Where each piece begins behind x, y and z, and where the last one ends."""
    return list(itertools.accumulate((len(_PIECES[piece]) for piece in order), initial=start + 3))


def _is_opaque(at: int, extent: Extent) -> bool:
    """Whether a column behind a colour is an alpha channel: 255 throughout."""
    return bool(extent.least[at] == extent.most[at] == 255)


def _fits(piece: str, at: int, extent: Extent) -> bool:
    if piece == "i":
        return True
    if piece == "n":
        return bool(extent.unit[at])
    least, most, whole = extent.least[at : at + 3], extent.most[at : at + 3], extent.whole[at : at + 3]
    if not (least >= 0).all():
        return False
    return bool((whole.all() and most.max() <= 255) or (most.max() <= 1 and not extent.unit[at]))


def _short(way: str, start: int) -> list[str]:
    letters = {name: letter for letter, name in SHORT_NAMES.items()}
    pieces = [letters.get(name, name) for piece in way for name in _PIECES[piece]]
    return [*([UNUSED] * start), *AXES, *pieces]


# --- colours


class Reach(NamedTuple):
    """The largest of some colours, and whether all are whole numbers."""

    most: float = 0.0
    whole: bool = True

    def with_more(self, values: np.ndarray) -> "Reach":
        """The range of these colours and of further ones; NaN counts as 0."""
        values = np.nan_to_num(values)
        whole = values.dtype.kind != "f" or bool((values == np.floor(values)).all())
        return Reach(max(self.most, float(values.max(initial=0))), self.whole and whole)


class Range(NamedTuple):
    """How the colours of a file become bytes."""

    brightest: float
    """The number of full brightness; 0 where they are no colours."""
    why: str

    @property
    def words(self) -> str:
        """The range in words, for the note."""
        return f"colours 0 to {self.brightest:g} by {self.why}" if self.brightest else f"no colours: {self.why}"


_TOO_BRIGHT = 16383
"""Limits beyond this are those of a type of 16 bits, not of a camera."""


def range_of(kind: np.dtype, reach: Reach, reading: Reading, *, stated: float | None = None) -> Range:
    """Find the number of full brightness.

    Args:
        kind: Type of the numbers; a floating-point type where they come from text.
        reach: The range of all colours.
        reading: What a person says.
        stated: What the file says.
    """
    most, whole = reach
    if reading.brightest is not None:
        return Range(reading.brightest, "--colours")
    # If the limits are those of 16 bits but 8 are used, the cloud would be black. With 10 or 12 bits it may be dark.
    black, white = (stated or 0) > _TOO_BRIGHT and 1 < most <= 255, most > 1.01 * (stated or 0)
    if stated is not None and not (black or white):
        return Range(stated, "the file's limits")
    if kind.itemsize == 1:
        return Range(255.0, "their type")
    is_float = kind.kind == "f"
    # A little above 1 is a rounding, or light that is brighter than white.
    if is_float and (most <= 1 or (most <= 2 and not whole)):
        return Range(1.0, f"the largest, {most:.3g}")
    but = f", not the {stated:g} that the file states" if stated else ""
    for brightest in (255.0, 65535.0):
        if most <= brightest:
            return Range(brightest, f"the largest, {most:.5g}{but}")
    return Range(0.0, f"they reach {most:.4g} (--colours)")


def as_bytes(values: np.ndarray, brightest: float) -> np.ndarray:
    """Colours in 8 bits; those that are no number are 0."""
    if values.dtype.itemsize == 1 and brightest == 255:
        # Some programs call unsigned bytes signed.
        return values.view(np.uint8)
    if values.dtype.kind in "iu" and brightest == 65535:
        # Exact for programs that wrote a byte into the upper half, and for those that repeated it.
        return (np.clip(values, 0, 65535) >> 8).astype(np.uint8)
    scaled = np.nan_to_num(values.astype(np.float64)) * (255.0 / brightest if brightest else 0.0)
    return np.clip(np.floor(scaled + 0.5), 0, 255).astype(np.uint8)


# --- units

_WORD_UNITS: dict[str, Unit] = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres", "millimètres"), "mm"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres", "centimètres"), "cm"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres", "mètre", "mètres", "metros"), "m"),
    **dict.fromkeys(("in", "inch", "inches", "zoll"), "inch"),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet", "fuss", "fuß"), "foot"),
    **dict.fromkeys(
        ("us survey foot", "us survey feet", "us-ft", "usft", "ft us", "ftus", "us foot", "us feet", "survey feet"),
        "us-foot",
    ),
}
_LONGEST_FIRST = "|".join(sorted(map(re.escape, _WORD_UNITS), key=len, reverse=True))
_STATED = re.compile(
    rf"(?:\b(?:length[ _]?)?(?:units?|einheit(?:en)?|unit[ée]s?|unidad(?:es)?)\b(?:\s+of\s+\w+)?[\s\"':=]*"
    rf"(?:(?:is|are|in|ist)\s+)?[\s\"'(\[]*"
    rf"|\b(?:coordinates|lengths|distances|positions|points|values|dimensions|xyz|koordinaten)\s+"
    rf"(?:are\s+)?(?:given\s+)?in\s+)({_LONGEST_FIRST})(?![\w²/])",
    re.IGNORECASE,
)


def unit_of(word: str) -> Unit | None:
    """The unit that a word names."""
    word = re.sub(r"[\s_.]+", " ", word.strip().strip("\"'").lower()).strip()
    return _WORD_UNITS.get(word)


def stated_of(name: str) -> Unit | None:
    """The unit in the name of a column, such as `X [mm]`."""
    bare = name.strip().strip("\"'").lower()
    found = _UNIT_OF_NAME.search(bare) or _UNIT_AT_END.search(bare)
    return unit_of(found[1]) if found else None


def stated_unit(lines: Iterable[str]) -> tuple[Unit | None, str]:
    """The unit that comments state, and the words that do; None where none does, or they contradict each other."""
    found: dict[Unit, str] = {}
    for line in lines:
        for match in _STATED.finditer(line[:1000]):
            unit = unit_of(match[1])
            # "in" before another word is the preposition, not inches.
            if unit is not None and not (match[1].lower() == "in" and re.match(r"\s+\w", line[match.end() :])):
                found.setdefault(unit, line.strip()[:40])
    if len(found) > 1:
        return None, f"its comments name several units: {', '.join(UNIT_WORDS[unit] for unit in found)}"
    return next(((unit, f'the comment "{text}"') for unit, text in found.items()), (None, ""))


# --- tables


def stored_cloud(
    points: Records,
    lines: Sequence[str],
    reading: Reading,
    *,
    columns: Columns | None = None,
    by: str = "their names",
    reach: Reach | None = None,
    profiles: np.ndarray | None = None,
    words: Iterable[str] = (),
) -> StoredCloud:
    """The cloud of a file, after a decision which columns are which, and which number is full brightness.

    Args:
        points: The records of the file, with its own names.
        lines: Its comments; those of our files are a header.
        columns: Where the reader has decided it, by the evidence `by`.
        reach: The range of the colours where the reader knows it; otherwise all points are read for it.
        profiles: As in `cloud_of`.
        words: Further decisions.
    """
    ours = bool(version_of(lines))
    names = points.dtype.names or ()
    if columns is None and reading.columns:
        columns, by = listed(names, reading.columns), "--columns"
    columns = columns or assign(names, ours=ours)
    places = dict(columns.places)
    found = [f"{', '.join((*AXES, *(name for name in places if name not in AXES)))} by {by}"]
    left = [name for name in columns.unused if name not in USED and name != "sigma"]
    found += [f"not used: {', '.join(left)[:80]}"] if left else []
    brightest = 0.0
    if set(COLOURS) <= places.keys():
        kind = np.result_type(*(points.dtype[places[name]] for name in COLOURS))
        if kind == np.uint8 and reading.brightest is None:
            brightest = 255.0
        else:
            coloured = range_of(kind, reach or _reach(points, [names[places[name]] for name in COLOURS]), reading)
            brightest = coloured.brightest
            found.append(coloured.words)
        if not brightest:
            places = {name: k for name, k in places.items() if name not in COLOURS}
    cloud, about = cloud_of(_renamed(points, places, brightest), lines, profiles=profiles), about_of(lines)
    if ours:
        return StoredCloud(cloud, about)
    unit, why = (columns.unit, "the names of its columns") if columns.unit else stated_unit(lines)
    about = about._replace(metres=None if unit is None else (METRES[unit],) * 3, unit_by=why)
    return StoredCloud(cloud, about, (*found, *words))


def _reach(points: Records, names: list[str]) -> Reach:
    reach = Reach()
    for block in points:
        for name in names:
            reach = reach.with_more(block[name])
    return reach


def _renamed(points: Records, places: dict[str, int], brightest: float) -> Records:
    """Records with the columns of a cloud alone; colours are bytes."""
    given = points.dtype.names or ()
    kinds = [(name, "u1" if name in COLOURS else points.dtype[k].newbyteorder("=").str) for name, k in places.items()]
    dtype = np.dtype(kinds)

    def read() -> Iterator[np.ndarray]:
        for block in points:
            table = np.empty(len(block), dtype)
            for name, k in places.items():
                values = block[given[k]]
                table[name] = as_bytes(values, brightest) if name in COLOURS else values
            yield table

    return Records(dtype, len(points), read)
