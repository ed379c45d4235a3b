"""Cameras in the files of other programs, read and written.

A file is read as a tree: a dict of trees, a list of trees, or a word. It may come from anyone, so nothing in it is
executed or looked up.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import yaml

from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration.calibration import CALIBRATION_FORMAT, CalibrationTable, load_parts
from jaxscan.files.disk import (
    MEGABYTE,
    Element,
    check,
    check_writable,
    parse_json,
    parse_xml,
    read_bounded,
    write_atomically,
)
from jaxscan.geometry import CAMERAS, AbstractCamera, AbstractMotion, LinearStage, Turntable, camera_doubts


Tree = Any
MAX_NUMBERS = 64
_MAX_LEVELS = 32
_MAX_ENTRIES = 2_000_000
_NUMBER = re.compile(r"[-+]?(?:\.\d+|\d+\.?\d*)(?:[eE][-+]?\d+)?")
_LONG_TEXT = re.compile(rb">[^<]{65536,}<")


def tree_of_xml(data: bytes, name: str, limit: int) -> Tree:
    """The tree of an XML file of OpenCV's FileStorage."""
    # Image points are longer than any XML may be here; a camera is not.
    root = parse_xml(_LONG_TEXT.sub(b"><", data), name=name, error=CalibrationError, limit=limit)
    if root.tag != "opencv_storage":
        raise CalibrationError(
            f"{name}: found <{root.tag:.40}>, expected <opencv_storage>, the XML of OpenCV; export the camera for "
            "OpenCV."
        )
    return _of_element(root)


def _of_element(element: Element) -> Tree:
    if not element.children:
        return element.text.strip()
    if all(child.tag == "_" for child in element.children):
        return [_of_element(child) for child in element.children]
    return {child.tag: _of_element(child) for child in element.children}


def tree_of_yaml(text: str, name: str) -> Tree:
    """The tree of the first document of a YAML file; every scalar is a word, and there are no aliases."""
    # The head of OpenCV's files, "%YAML:1.0", is none of YAML.
    text = re.sub(r"\A\ufeff?(?:%[^\n]*\n)*", "", text)
    try:
        events = yaml.parse(text, Loader=yaml.CBaseLoader)
        for event in events:
            if isinstance(event, yaml.NodeEvent):
                return _Builder(events, name).tree(event, 0)
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = "" if mark is None else f"line {mark.line + 1}: "
        said = getattr(problem, "problem", None) or str(problem).splitlines()[0]
        raise CalibrationError(f"{name}: {line}not readable as YAML: {said:.100}.") from None
    return {}


class _Builder:
    """Builds a tree of the events of a parser, as long as it is not too deep or too large."""

    def __init__(self, events: Iterator[Any], name: str) -> None:
        self._events, self._name, self._entries = events, name, 0

    def tree(self, event: Any, level: int) -> Tree:
        """The value that begins with an event."""
        self._entries += 1
        if level > _MAX_LEVELS or self._entries > _MAX_ENTRIES:
            raise self._odd(event, f"at most {_MAX_LEVELS} levels and {_MAX_ENTRIES} entries")
        if isinstance(event, yaml.ScalarEvent):
            return event.value
        if isinstance(event, yaml.SequenceStartEvent):
            items = []
            while not isinstance(inner := next(self._events), yaml.SequenceEndEvent):
                items.append(self.tree(inner, level + 1))
            return items
        if not isinstance(event, yaml.MappingStartEvent):
            raise self._odd(event, "no alias")
        table: dict[str, Tree] = {}
        while not isinstance(inner := next(self._events), yaml.MappingEndEvent):
            key = str(self.tree(inner, level + 1))
            if key in table:
                raise self._odd(inner, f"the key {key:.40} only once")
            table[key] = self.tree(next(self._events), level + 1)
        return table

    def _odd(self, event: Any, expected: str) -> CalibrationError:
        return CalibrationError(f"{self._name}: line {event.start_mark.line + 1}: expected {expected}.")


def leaves(tree: Tree, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Tree]]:
    """All values below tables, each with the keys that lead to it; a matrix with `data` is one value.

    Points within keys, as in `Camera.fx`, count as tables.
    """
    if isinstance(tree, dict) and "data" not in tree:
        for key, value in tree.items():
            yield from leaves(value, (*path, *str(key).split(".")))
    elif isinstance(tree, list) and any(isinstance(one, dict) for one in tree):
        for number, value in enumerate(tree):
            yield from leaves(value, (*path, str(number)))
    else:
        yield path, tree


def numbers(value: Tree, where: str) -> list[float]:
    """The numbers of a list, nested or not, of a matrix with `data`, or of a text that commas or blanks part.

    Raises:
        CalibrationError: If there is something else, there are more than 64, or other ones than rows and columns say.
    """
    if isinstance(value, dict):
        if "data" not in value:
            raise CalibrationError(f"{where}: found the keys {', '.join(value)[:60]}, expected numbers in a list.")
        found = numbers(value["data"], where)
        sides = [numbers(value[side], where) for side in ("rows", "cols") if side in value]
        if len(sides) == 2 and all(len(side) == 1 for side in sides) and sides[0][0] * sides[1][0] != len(found):
            raise CalibrationError(
                f"{where}: found {len(found)} numbers, expected {sides[0][0]:g} rows of {sides[1][0]:g}."
            )
        return found
    words = _words(value, where)
    for word in words:
        # 09 is the rest of a number whose comma was meant as its point.
        if not _NUMBER.fullmatch(word) or re.match(r"[-+]?0\d", word):
            raise CalibrationError(
                f"{where}: found {word!r:.40}, expected numbers parted by commas or by blanks, with decimal points."
            )
    return [float(word) for word in words]


def _words(value: Tree, where: str) -> list[str]:
    """The words of all numbers in a value, in their order."""
    found: list[str] = []
    if isinstance(value, list):
        for one in value[: MAX_NUMBERS + 1]:
            # Beside others a text is one number; alone it may be a row of them.
            found += [one.strip()] if isinstance(one, str) and len(value) > 1 else _words(one, where)
    elif isinstance(value, str):
        separator = "," if "," in value else None
        found = [part.strip() for part in value.strip().removesuffix(",").split(separator)]
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise CalibrationError(f"{where}: found {value!r:.40}, expected numbers in a list.")
    else:
        found = [repr(value)]
    if len(found) > MAX_NUMBERS:
        count = len(value) if isinstance(value, list) else len(found)
        raise CalibrationError(f"{where}: found {count} numbers, expected at most {MAX_NUMBERS}.")
    return found


# Cameras of other programs: OpenCV, ROS, Kalibr, EuRoC, ORB-SLAM, mrcal, COLMAP and scripts, and our own calibrations.
#
# The files may come from anyone; nothing in a file is ever executed. A part that is not found is missed, never taken as
# zero, and what is found and not used is named.

MAX_CAMERA_BYTES = 16 * MEGABYTE
_SUFFIXES = (
    ".json (ours, OpenCV, scripts), .yaml or .yml (OpenCV, ROS, Kalibr), .xml (OpenCV), .cameramodel (mrcal) or .txt "
    "(COLMAP)"
)

Model = Literal["pinhole", "fisheye", "double_sphere"]

# Names of parts as programs and scripts write them, in small letters without anything between them.
_MATRIX = frozenset(
    "cameramatrix cammatrix cameraintrinsics cameraintrinsic cameraintrinsicmatrix intrinsics intrinsic "
    "intrinsicmatrix intrinsicsmatrix intrinsicparameters k kmatrix mtx matrix m cammtx cameramtx".split()
)
_LENS = frozenset(
    "distortioncoefficients distortioncoefficient distortioncoeffs distortioncoeff distortioncoefs distortioncoef "
    "distcoeffs distcoeff distcoefs distcoef distcoefficients distcoefficient distortion distortions dist kc d coeffs "
    "coefficients distortionparameters distortionparams distparams distortionvector distortionmatrix distortionvalues "
    "lensdistortion cameradistortion cameradistortioncoefficients distcoffs disto".split()
)
_WIDTH = frozenset("imagewidth width imgwidth camerawidth framewidth imagewidthpx widthpx w".split())
_HEIGHT = frozenset("imageheight height imgheight cameraheight frameheight imageheightpx heightpx h".split())
_COLUMNS, _ROWS = frozenset("cols columns imagecols".split()), frozenset("rows imagerows".split())
"""As stella_vslam writes them. A size under the names of the next line would be that of a board."""
_SMALLEST_PX = 64
_SIZE = frozenset("imagesize imgsize resolution imageresolution cameraresolution size origres framesize".split())
_MODEL = frozenset("distortionmodel distmodel lensmodel lenstype distortiontype projectionmodel".split())
_CAMERA_MODEL = frozenset("cameramodel model modeltype cameratype".split())
"""Kalibr's and EuRoC's `pinhole` stands beside a model of the distortion."""
_ELSEWHERE = re.compile(r"board|pattern|chess|checker|charuco|marker|target|grid|roi")
"""Tables with a width and height that are no image's."""
_FLAG = frozenset(("fisheye", "fisheyemodel", "isfisheye"))
_PIXELS = {"ppx": "cx", "ppy": "cy", "focallengthx": "fx", "focallengthy": "fy", "skew": "skew", "alphac": "alpha"}
_PIXELS |= {name: name for name in ("fx", "fy", "cx", "cy")}
_PIXELS |= {"mu": "fx", "mv": "fy", "u0": "cx", "v0": "cy"}
"""The last four are camodocal's, whose Kannala-Brandt counts its coefficients from k2 to k5."""
_PAIRS = {"fc": ("fx", "fy"), "cc": ("cx", "cy"), "focallength": ("fx", "fy"), "principalpoint": ("cx", "cy")}
"""Keys of Bouguet's toolbox, and those that OpenCV derived from it."""
_COEFFICIENT = re.compile(r"k[1-6]|p[12]|s[1-4]|tau[xy]|xi|alpha")
_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "taux", "tauy")
"""Order of OpenCV's list of coefficients."""
_GENERIC = frozenset("model type coefficients coeffs matrix values parameters params data size resolution".split())
_ONE_OF_TWO = re.compile(r"(.+?)(?:left|right|[0-9lr])")

_WORDS: dict[Model, str] = {
    "pinhole": "plumbbob rationalpolynomial rational brown brownconrady radtan radtan5 radtan8 radialtangential "
    "pinhole opencv fullopencv none nodistortion perspective standard pinholeradtan simplepinhole",
    "fisheye": "fisheye equidistant equi kannalabrandt kannalabrandt4 kannalabrandt8 kb4 opencvfisheye pinholeequi",
    "double_sphere": "ds dsnone doublesphere",
}
_MODELS = {word: model for model, words in _WORDS.items() for word in words.split()}
_WITHOUT = frozenset(("none", "nodistortion", "simplepinhole"))
"""Words that say that the lens has no coefficients."""


class ReadCamera(NamedTuple):
    """A camera, and what its file says beside it."""

    camera: AbstractCamera
    note: str
    """Which keys were used and which were not; empty for a calibration of this library."""


def read_camera(
    path: str | Path, size: tuple[int, int] | None = None, *, unnamed: Literal["pinhole", "fisheye"] = "pinhole"
) -> ReadCamera:
    """A camera from a file of another program, or from a calibration of our own.

    Args:
        path: `.json` is our own, or that of OpenCV or a script; `.yaml` and `.yml` are those of OpenCV, ROS, Kalibr and
            their like; `.xml` is OpenCV's, `.cameramodel` mrcal's, `.txt` COLMAP's list of cameras.
        size: Width and height of the images [px], for a file that does not say.
        unnamed: The model of a file that names none, as OpenCV's own samples write them: k1, k2, p1, p2 of a pinhole
            look like k1 to k4 of a fisheye.

    Returns:
        The camera, and a note; a pinhole has 5 coefficients, or 8 where the file has more.

    Raises:
        CalibrationError: One line with the key, the value found and the values allowed.
    """
    path = Path(path)
    suffix, name = path.suffix.lower(), str(path)
    if suffix not in (".json", ".yaml", ".yml", ".xml", ".cameramodel", ".txt"):
        raise CalibrationError(f'{path}: found "{path.suffix}", expected a camera as {_SUFFIXES}.')
    data = read_bounded(path, MAX_CAMERA_BYTES, error=CalibrationError)
    if suffix == ".json":
        tree = parse_json(data, name=name, error=CalibrationError)
        if isinstance(tree, dict) and str(tree.get("format", "")).startswith("jaxscan"):
            return ReadCamera(load_parts(path)[0], "")
        return _camera(_of_tree(tree, name, size, unnamed), name)
    if suffix == ".xml":
        return _camera(_of_tree(tree_of_xml(data, name, MAX_CAMERA_BYTES), name, size, unnamed), name)
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise CalibrationError(f"{path}: is no text, expected the camera that its suffix names.") from None
    if suffix in (".cameramodel", ".txt"):
        return _camera((_of_mrcal if suffix == ".cameramodel" else _of_colmap)(text, name), name)
    return _camera(_of_tree(tree_of_yaml(text, name), name, size, unnamed), name)


class _Parts(NamedTuple):
    """The parts of a camera as a file holds them."""

    model: Model
    pixels: dict[str, float]
    lens: Sequence[float]
    lens_from: str
    size: Sequence[float]
    unused: Sequence[str] = ()
    more: str = ""


_COUNTS: dict[Model, tuple[int, ...]] = {"pinhole": (5, 8), "fisheye": (4,), "double_sphere": (2,)}
"""Numbers of coefficients that a camera has; a file may leave out zeros, and write more."""


def _camera(parts: _Parts, name: str) -> ReadCamera:
    """The camera of its parts, after the checks of a calibration of our own, and its note."""
    model, lens = parts.model, [float(value) for value in parts.lens]
    if len(parts.size) != 2 or not all(float(side).is_integer() for side in parts.size):
        raise CalibrationError(f"{name}: size of the images: found {list(parts.size)}, expected whole pixels.")
    if model == "pinhole" and len(lens) in (3, 6, 7):
        raise CalibrationError(
            f"{name}: distortion coefficients: found {len(lens)}, expected 4, 5, 8, 12 or 14 (k1, k2, p1, p2, k3, ...)."
        )
    used = max((k + 1 for k, value in enumerate(lens) if value != 0), default=0)
    full = next((count for count in _COUNTS[model] if used <= count), 0)
    if not full:
        most = _COUNTS[model][-1]
        words = [f"{key} = {value:g}" for key, value in zip(_ORDER[most:], lens[most:], strict=False) if value]
        raise CalibrationError(
            f"{name}: distortion coefficients: found {len(lens)}, of which {', '.join(words) or 'some'}; expected at "
            f"most {most} that are not 0 for a {model} camera: thin prisms and tilted sensors are not known here."
        )
    names = [one for block in CAMERAS[model].lens for one in block.parameters][:full]
    table: dict[str, Any] = {"model": model, "width": int(parts.size[0]), "height": int(parts.size[1])}
    table |= {"skew": 0.0} | {key: float(value) for key, value in parts.pixels.items()}
    table["distortion"] = dict(zip(names, lens + [0.0] * full, strict=False))
    tables = {"format": CALIBRATION_FORMAT, "camera": table}
    camera = check(CalibrationTable, tables, name=name, error=CalibrationError).camera.camera()
    doubts = camera_doubts(camera)
    if impossible := [doubt.said for doubt in doubts if doubt.impossible]:
        raise CalibrationError(f"{name}: {impossible[0]}.")
    skew = f", skew {table['skew']:g} px" if table["skew"] else ""
    note = f"{name}: read as a {model} of {table['width']} x {table['height']} px{skew} with "
    note += f"{', '.join(names[: len(lens)]) or 'no coefficients'} ({parts.lens_from}); "
    note += f"not used: {_listed(parts.unused)}." if parts.unused else "every key is used."
    return ReadCamera(camera, " But ".join([note + parts.more, *(f"{doubt.said}." for doubt in doubts)]))


def _plain(word: object) -> str:
    return re.sub(r"[^a-z0-9]", "", str(word).lower())


def _one_line(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


class _Keys:
    """The values of a file by their possible meanings. Each is used once, or named as not used."""

    def __init__(self, tree: Tree, name: str) -> None:
        self.name = name
        # Keys are shown in messages of one line.
        self._values = {_one_line(".".join(path)): value for path, value in leaves(tree)}
        self.used: set[str] = set()

    def of(self, known: frozenset[str], part: str, *, count: int | None = None, listed: bool = False) -> str | None:
        """The key of the value whose name is known, the one nearest to the root."""
        named = [key for key in self._values if self._plain_name(key, known) and self._has(key, count)]
        named = [key for key in named if self._is_list(key)] if listed else named
        nearest = min((key.count(".") for key in named), default=0)
        named = [key for key in named if key.count(".") == nearest]
        if len(named) > 1 and any(self._values[key] != self._values[named[0]] for key in named):
            raise CalibrationError(
                f"{self.name}: holds {part} {len(named)} times ({', '.join(named)[:80]}), expected one camera: take "
                "the other out."
            )
        self.used.update(named)
        return named[0] if named else None

    def side_by_side(self, first: frozenset[str], second: frozenset[str], least: int) -> list[str]:
        """The keys of two numbers in one table, both at least `least`; none where no table has such a pair."""
        keys = [key for key in self._values if self._has(key, 1) and self.numbers(key)[0] >= least]
        pairs = [
            [one, other]
            for one in keys
            for other in keys
            if self._plain_name(one, first) and self._plain_name(other, second)
            if one.rpartition(".")[0] == other.rpartition(".")[0]
        ]
        found = pairs[0] if len(pairs) == 1 else []
        self.used.update(found)
        return found

    def numbers(self, key: str) -> list[float]:
        return numbers(self._values[key], f"{self.name}: {key}")

    def word(self, key: str) -> str:
        value = self._values[key]
        return str(value).strip().strip("\"'")

    def listed(self) -> str:
        """All keys of the file."""
        return _listed(list(self._values))

    def unused(self) -> list[str]:
        return [key for key in self._values if key not in self.used]

    def _has(self, key: str, count: int | None) -> bool:
        if count is None:
            return True
        try:
            return len(self.numbers(key)) == count
        except CalibrationError:
            # A bad value is an error only where no other key holds the numbers.
            return False

    def _is_list(self, key: str) -> bool:
        value = self._values[key]
        return isinstance(value, list | dict) or bool(re.search(r"\[|\S\s+\S", str(value)))

    def _plain_name(self, key: str, known: frozenset[str]) -> bool:
        *above, last = map(_plain, key.split("."))
        if any(_ELSEWHERE.search(one) for one in above):
            return False
        names = {last, (above[-1] if above else "") + last} if last in _GENERIC else {last}
        if names & known:
            return True
        # K1 and D1 of a pair of cameras; k1 alone is a coefficient.
        found = _ONE_OF_TWO.fullmatch(last)
        return bool(found and found[1] in known and self._is_list(key))


def _listed(keys: Sequence[str], most: int = 8) -> str:
    shown = [key[:40] for key in keys[:most]]
    return ", ".join(shown) + (f" and {len(keys) - most} more" if len(keys) > most else "")


def _of_tree(tree: Tree, name: str, size: tuple[int, int] | None, unnamed: Literal["pinhole", "fisheye"]) -> _Parts:
    keys = _Keys(tree, name)
    model, without = _model(keys)
    pixels, lens = _pixels(keys)
    if model != "double_sphere" and (key := keys.of(frozenset(("xi",)), "xi")) is not None:
        raise CalibrationError(
            f"{name}: {key}: found xi, which the unified (MEI, omni) and double sphere models have; expected a "
            "pinhole, a fisheye without it, or Kalibr's ds."
        )
    chosen: Model = model or ("double_sphere" if len(lens) == 2 else unnamed)
    if (len(lens) == 2) != (chosen == "double_sphere"):
        expected = 6 if chosen == "double_sphere" else 4
        raise CalibrationError(
            f"{name}: intrinsics: found {4 + len(lens)} numbers, expected {expected} for a {chosen} camera."
        )
    lens, lens_from = (lens, "intrinsics") if lens else _read_lens(keys, chosen, without=without)
    more = " It names no model: four coefficients may be those of a pinhole or, with --lens fisheye, of a fisheye."
    sides = _size(keys, size)
    return _Parts(chosen, pixels, lens, lens_from, sides, keys.unused(), "" if model or len(lens) != 4 else more)


def _model(keys: _Keys) -> tuple[Model | None, bool]:
    """The model that a file names, None where it names none; and whether it says that there are no coefficients."""
    found: list[tuple[str, str]] = []
    for names in (_MODEL, _CAMERA_MODEL):
        key = keys.of(names, "a model")
        if key is not None and (key, keys.word(key)) not in found:
            found.append((key, keys.word(key)))
    model: Model | None = None
    without = False
    for key, word in found:
        if _plain(word) == "":
            continue
        named = _MODELS.get(_plain(word))
        if named is None:
            raise CalibrationError(
                f"{keys.name}: {key}: found {word!r:.40}, expected plumb_bob, rational_polynomial, radtan, equidistant "
                "(fisheye) or ds (double sphere)."
            )
        without = without or _plain(word) in _WITHOUT
        # `camera_model: pinhole` stands beside `distortion_model: equidistant`.
        model = named if model in (None, "pinhole") else model
    flag = keys.of(_FLAG, "a flag of a fisheye")
    if flag is not None and keys.word(flag).lower() in ("1", "true", "yes"):
        model = "fisheye"
    return model, without


def _pixels(keys: _Keys) -> tuple[dict[str, float], list[float]]:
    """fx, fy, cx, cy and skew [px]; and the coefficients that stand before them, as in Kalibr's `ds`."""
    if (key := keys.of(_MATRIX, "a camera matrix", count=9)) is not None:
        return _of_matrix(keys.numbers(key), f"{keys.name}: {key}"), []
    for count in (4, 6):
        if (key := keys.of(frozenset(("intrinsics",)), "intrinsics", count=count)) is not None:
            *lens, fx, fy, cx, cy = keys.numbers(key)
            return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": 0.0}, lens
    found: dict[str, float] = {}
    for names in _PAIRS:
        if (key := keys.of(frozenset((names,)), names, count=2)) is not None:
            found |= dict(zip(_PAIRS[names], keys.numbers(key), strict=True))
    for name, meaning in _PIXELS.items():
        if (key := keys.of(frozenset((name,)), name, count=1)) is not None:
            found[meaning] = keys.numbers(key)[0]
    if found.keys() >= {"fx", "fy", "cx", "cy"}:
        found["skew"] = found.get("skew", 0.0) + found.pop("alpha", 0.0) * found["fx"]
        return found, []
    # A matrix that does not have nine numbers is shown in the message.
    if (key := keys.of(_MATRIX, "a camera matrix")) is not None:
        _of_matrix(keys.numbers(key), f"{keys.name}: {key}")
    raise CalibrationError(
        f"{keys.name}: camera_matrix: missing, expected a camera matrix (camera_matrix, K, mtx) or fx, fy, cx, cy; "
        f"found the keys {keys.listed()}."
    )


def _of_matrix(matrix: Sequence[float], where: str) -> dict[str, float]:
    if len(matrix) == 9 and matrix[8] == 1 and [matrix[at] for at in (1, 2, 5)] == [0, 0, 0] and matrix[6] != 0:
        raise CalibrationError(
            f"{where}: is transposed, as MATLAB writes it, whose pixels count from 1; expected [fx s cx; 0 fy cy; "
            "0 0 1] with cx and cy less by 1."
        )
    if len(matrix) != 9 or [matrix[at] for at in (3, 6, 7)] != [0, 0, 0] or matrix[8] != 1:
        raise CalibrationError(f"{where}: found {matrix[:9]}, expected the camera matrix [fx s cx; 0 fy cy; 0 0 1].")
    fx, skew, cx, _, fy, cy, *_ = matrix
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": skew}


def _read_lens(keys: _Keys, model: Model, *, without: bool) -> tuple[list[float], str]:
    """The coefficients in the model's order, and the key or keys that have them."""
    if (key := keys.of(_LENS, "coefficients of a lens", listed=True)) is not None:
        return keys.numbers(key), key
    named: dict[str, float] = {}
    where: list[str] = []
    order = {"fisheye": ("k1", "k2", "k3", "k4"), "double_sphere": ("xi", "alpha"), "pinhole": _ORDER}[model]
    if model == "fisheye" and keys.of(frozenset(("k5",)), "k5", count=1) and not keys.of(frozenset(("k1",)), "k1"):
        order = ("k2", "k3", "k4", "k5")
    for name in order:
        if (key := keys.of(frozenset((name,)), name, count=1)) is not None:
            named[name] = keys.numbers(key)[0]
            where.append(key)
    if named:
        last = max(order.index(name) for name in named)
        # p1 and p2 may be left out, but not a lower coefficient of a series.
        gaps = [name for name in order[:last] if name not in named and name not in ("p1", "p2", "s1", "s2", "s3", "s4")]
        gaps += [name for name, other in (("p1", "p2"), ("p2", "p1")) if other in named and name not in named]
        if gaps:
            raise CalibrationError(
                f"{keys.name}: {', '.join(gaps)}: missing beside {', '.join(named)}; expected 0 where a coefficient is."
            )
        return [named.get(name, 0.0) for name in order[: last + 1]], ", ".join(where)
    if without:
        return [], "the model has none"
    raise CalibrationError(
        f"{keys.name}: coefficients of the lens: missing, expected distortion_coefficients, dist_coeffs, D, kc or k1, "
        f'k2; found the keys {keys.listed()}. A lens without distortion has "distortion_coefficients: [0, 0, 0, 0, 0]".'
    )


def _size(keys: _Keys, known: tuple[int, int] | None) -> Sequence[float]:
    sides = [keys.of(_WIDTH, "a width"), keys.of(_HEIGHT, "a height")]
    if sides.count(None) == 1:
        raise CalibrationError(
            f"{keys.name}: {sides[0] or sides[1]}: found only one of them, expected width and height."
        )
    found = [side for side in sides if side is not None]
    if not found and (key := keys.of(_SIZE, "a size of images", count=2)) is not None:
        return keys.numbers(key)
    found = found or keys.side_by_side(_COLUMNS, _ROWS, _SMALLEST_PX)
    if not found and known is None:
        raise CalibrationError(f"{keys.name}: image_width, image_height: missing, expected the size of the images.")
    return [number for key in found for number in keys.numbers(key)] if found else [float(side) for side in known or ()]


def _of_mrcal(text: str, name: str) -> _Parts:
    # Looked for rather than parsed: a model may hold megabytes of its optimisation, and a parser takes far more.
    text = re.sub(r"#[^\n]*", "", text)
    lens = (re.findall(r"""['"]lensmodel['"]\s*:\s*b?['"]([^'"\n]*)['"]""", text) or [""])[0]
    counts = {"LENSMODEL_PINHOLE": 0, **{f"LENSMODEL_OPENCV{count}": count for count in (4, 5, 8, 12)}}
    if lens not in counts:
        raise CalibrationError(f"{name}: lensmodel: found {lens!r:.60}, expected one of {', '.join(counts)}.")
    lists = (re.findall(rf"""['"]{key}['"]\s*:\s*(\[[^\[\]]*\])""", text) for key in ("intrinsics", "imagersize"))
    values, size = (numbers(found[0][1:-1], name) if found else [] for found in lists)
    if len(values) != 4 + counts[lens] or len(size) != 2:
        raise CalibrationError(
            f"{name}: intrinsics, imagersize: found {len(values)} and {len(size)} numbers, expected {4 + counts[lens]} "
            f"and 2, as {lens} has them."
        )
    keys = dict.fromkeys(re.findall(r"""['"](\w{1,40})['"]\s*:""", text))
    unused = [key for key in keys if key not in ("lensmodel", "intrinsics", "imagersize")]
    pixels = dict(zip(("fx", "fy", "cx", "cy"), values, strict=False))
    return _Parts("pinhole", pixels, values[4:], lens, size, unused)


# Parameters of COLMAP's models, in its order. Source: colmap.github.io/cameras.html
_COLMAP: dict[str, tuple[Model, str]] = {
    "SIMPLE_PINHOLE": ("pinhole", "f cx cy"),
    "PINHOLE": ("pinhole", "fx fy cx cy"),
    "SIMPLE_RADIAL": ("pinhole", "f cx cy k1"),
    "RADIAL": ("pinhole", "f cx cy k1 k2"),
    "OPENCV": ("pinhole", "fx fy cx cy k1 k2 p1 p2"),
    "FULL_OPENCV": ("pinhole", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", "f cx cy k1"),
    "RADIAL_FISHEYE": ("fisheye", "f cx cy k1 k2"),
    "OPENCV_FISHEYE": ("fisheye", "fx fy cx cy k1 k2 k3 k4"),
}


def _of_colmap(text: str, name: str) -> _Parts:
    """The one camera of a `cameras.txt`; COLMAP's first pixel has its centre at (0.5, 0.5)."""
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) != 1 or len(lines[0]) < 5:
        raise CalibrationError(
            f"{name}: found {len(lines)} lines, expected the line of one camera as COLMAP's cameras.txt has it: "
            "CAMERA_ID MODEL WIDTH HEIGHT PARAMS."
        )
    _, called, *words = lines[0]
    if called not in _COLMAP:
        raise CalibrationError(f"{name}: model: found {called!r:.40}, expected one of {', '.join(_COLMAP)}.")
    model, order = _COLMAP[called]
    names, size, values = order.split(), numbers(words[:2], name), numbers(words[2:], name)
    if len(values) != len(names):
        raise CalibrationError(
            f"{name}: found {len(words)} numbers after {called}, expected WIDTH HEIGHT {' '.join(names)}."
        )
    found = dict(zip(names, values, strict=True))
    pixels = {key: found[key] if key in found else found["f"] for key in ("fx", "fy")}
    pixels |= {"cx": found["cx"] - 0.5, "cy": found["cy"] - 0.5}
    lens = [value for key, value in found.items() if _COEFFICIENT.fullmatch(key)]
    return _Parts(model, pixels, lens, called, size, more=" The centre is 0.5 px less than COLMAP's.")


# Calibrations for other programs: OpenCV, ROS, mrcal, Kalibr.
#
# All count pixels alike: (0, 0) is the centre of the top-left pixel. Numbers are written so
# that they are read back to the last bit.

CameraFormat = Literal["opencv", "ros", "mrcal", "kalibr"]

FORMAT_OF: dict[str, CameraFormat] = {".cameramodel": "mrcal", ".yaml": "opencv", ".yml": "opencv"}
"""The format that a suffix stands for, where no format is named."""

_HELD_BY: dict[CameraFormat, tuple[str, ...]] = {
    "opencv": ("brown", "rational", "fisheye"),
    "ros": ("brown", "rational", "fisheye"),
    "mrcal": ("brown", "rational"),
    "kalibr": ("brown", "fisheye", "double_sphere"),
}
"""Lenses that each format can hold."""
_LENS_NAMES = {"fisheye": "Kannala-Brandt fisheye", "double_sphere": "double sphere", "rational": "rational pinhole"}


def export_camera(calibration: Calibration, path: str | Path, camera_format: CameraFormat | None = None) -> None:
    """Write a calibration as another program reads it.

    Args:
        calibration: Its camera is written; OpenCV's file also holds laser sheets and axis, under
            keys of our own.
        path: An existing file is replaced when the new one is complete.
        camera_format: Where None, the suffix decides: `.cameramodel` is mrcal's, `.yaml` and `.yml` OpenCV's.

    Raises:
        CalibrationError: If the format is not known, cannot hold the model, or the file cannot be
            written.
    """
    path = Path(path)
    chosen = check_camera_path(path, camera_format)
    text = _WRITERS[chosen](_lens(calibration.camera, chosen, path), calibration, path)
    write_atomically(path, text.encode(), error=CalibrationError)


def check_camera_path(path: str | Path, camera_format: CameraFormat | None = None) -> CameraFormat:
    """The format of a file, after a check that the file can be written.

    Raises:
        CalibrationError: If the suffix names no format, or nothing can be written there.
    """
    path = Path(path)
    chosen = camera_format or FORMAT_OF.get(path.suffix.lower())
    if chosen is None:
        raise CalibrationError(
            f'{path}: "{path.suffix}" names no format of a calibration; known are {", ".join(FORMAT_OF)}, '
            f"or say --format {'|'.join(get_args(CameraFormat))}."
        )
    check_writable(path, error=CalibrationError)
    return chosen


def _lens(camera: AbstractCamera, camera_format: CameraFormat, path: Path) -> str:
    """The lens: "brown" (5 coefficients) or "rational" (8) for a pinhole, otherwise the name of the camera model."""
    skew = float(getattr(camera, "skew", 0.0))
    if skew != 0.0:
        raise CalibrationError(f"{path}: the camera has a skew of {skew:g} px, which {camera_format} cannot hold.")
    pinholes = {5: "brown", 8: "rational"}
    lens = pinholes.get(len(camera.distortion), "pinhole") if camera.model == "pinhole" else camera.model
    if lens not in _HELD_BY[camera_format]:
        able = [name for name, lenses in _HELD_BY.items() if lens in lenses]
        raise CalibrationError(
            f"{path}: {camera_format} has no {_LENS_NAMES.get(lens, lens)} camera, so it cannot hold this one"
            + (f"; export it for {' or '.join(able)} instead." if able else ".")
        )
    return lens


def _opencv(lens: str, calibration: Calibration, path: Path) -> str:
    """A file for `cv2.FileStorage`; for a fisheye, coefficients as `cv2.fisheye` takes them.

    Sheets `normal . p = distance` and axis, camera frame at angle 0, metres and radians.
    """
    camera, scanner = calibration.camera, calibration.scanner
    fields = {
        "image_width": camera.width,
        "image_height": camera.height,
        "distortion_model": lens,
        "camera_matrix": _matrix(camera),
        "distortion_coefficients": _row(camera.distortion),
    }
    if scanner is not None:
        fields["jaxscan_laser_count"] = len(scanner.laser_names)
        for index, name in enumerate(scanner.laser_names):
            sheet, key = scanner.laser(index), f"jaxscan_laser_{index}"
            fields |= {
                f"{key}_name": _quoted(name),
                f"{key}_normal": _row(sheet.normal).T,
                f"{key}_distance_m": _number(sheet.distance),
                f"{key}_bow": _row(sheet.bow).T,
            }
        fields |= _motion(scanner.turntable)
    matrix = "{}: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [ {} ]"
    return "%YAML:1.0\n---\n" + _yaml(fields, matrix)


def _motion(motion: AbstractMotion) -> dict[str, object]:
    """The motion between records, under keys of our own."""
    if isinstance(motion, LinearStage):
        return {
            "jaxscan_turntable_carries": _quoted(motion.carries),
            "jaxscan_travel_direction": _row(motion.direction).T,
            "jaxscan_travel_gain": _number(motion.gain),
        }
    if not isinstance(motion, Turntable):
        return {}
    return {
        "jaxscan_turntable_carries": _quoted(motion.carries),
        "jaxscan_axis_direction": _row(motion.direction).T,
        "jaxscan_axis_point_m": _row(motion.point).T,
        "jaxscan_turntable_gain": _number(motion.gain),
        "jaxscan_turntable_harmonics": _row(motion.harmonics).T,
    }


def _quoted(text: str) -> str:
    """A string that OpenCV's reader takes back: its escapes know ASCII alone."""
    return json.dumps("".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in text))


def _ros(lens: str, calibration: Calibration, path: Path) -> str:
    """A `camera_info` file of `camera_calibration_parsers`; the image is not rectified further."""
    camera = calibration.camera
    fields = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": _matrix(camera),
        "distortion_model": {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}[lens],
        "distortion_coefficients": _row(camera.distortion),
        "rectification_matrix": np.eye(3),
        "projection_matrix": np.hstack([_matrix(camera), np.zeros((3, 1))]),
    }
    return _yaml(fields, "{}:\n  rows: {}\n  cols: {}\n  data: [{}]")


def _mrcal(lens: str, calibration: Calibration, path: Path) -> str:
    """A `.cameramodel`: a Python literal. The camera is its own reference frame."""
    camera = calibration.camera
    return (
        "{\n"
        f"    'lensmodel': 'LENSMODEL_OPENCV{len(camera.distortion)}',\n\n"
        "    # fx, fy, cx, cy, then the coefficients in OpenCV's order\n"
        f"    'intrinsics': [ {_numbers(*_pinhole(camera), *camera.distortion)} ],\n\n"
        "    # rt from the reference frame, which is the camera's own\n"
        "    'extrinsics': [ 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 ],\n\n"
        f"    'imagersize': [ {camera.width}, {camera.height} ]\n"
        "}\n"
    )


def _kalibr(lens: str, calibration: Calibration, path: Path) -> str:
    """A `camchain.yaml` of one camera, as Kalibr and Basalt read it."""
    camera = calibration.camera
    camera_model, distortion_model = "pinhole", "none"
    intrinsics, coefficients = _pinhole(camera), tuple(camera.distortion)
    if lens == "double_sphere":
        camera_model, intrinsics, coefficients = "ds", (*coefficients, *intrinsics), ()
    elif lens == "fisheye":
        distortion_model = "equidistant"
    elif coefficients[4] == 0.0:
        distortion_model, coefficients = "radtan", coefficients[:4]
    else:
        raise CalibrationError(f"{path}: kalibr has no k3, so it cannot hold this camera; calibrate it with --hold k3.")
    fields = {
        "camera_model": camera_model,
        "intrinsics": f"[{_numbers(*intrinsics)}]",
        "distortion_model": distortion_model,
        "distortion_coeffs": f"[{_numbers(*coefficients)}]",
        "resolution": f"[{camera.width}, {camera.height}]",
    }
    return "cam0:\n" + "".join(f"  {key}: {value}\n" for key, value in fields.items())


def _yaml(fields: Mapping[str, object], matrix: str) -> str:
    """A line per field; for arrays [rows, columns] the template `matrix` with name, rows, columns and numbers."""
    lines = [
        matrix.format(name, *value.shape, _numbers(*value.ravel()))
        if isinstance(value, np.ndarray)
        else f"{name}: {value}"
        for name, value in fields.items()
    ]
    return "\n".join(lines) + "\n"


def _pinhole(camera: AbstractCamera) -> tuple[object, ...]:
    return camera.fx, camera.fy, camera.cx, camera.cy


def _matrix(camera: AbstractCamera) -> np.ndarray:
    """The camera matrix [px]."""
    fx, fy, cx, cy = _row(_pinhole(camera))[0]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _row(values: object) -> np.ndarray:
    return np.asarray(values, np.float64)[None]


def _number(value: object) -> str:
    """The shortest digits that mean this float64, with the point without which YAML 1.1 sees text."""
    digits = repr(float(np.asarray(value)))
    return digits if "." in digits else digits.replace("e", ".0e")


def _numbers(*values: object) -> str:
    return ", ".join(map(_number, values))


_WRITERS: dict[CameraFormat, Callable[[str, Calibration, Path], str]] = {
    "opencv": _opencv,
    "ros": _ros,
    "mrcal": _mrcal,
    "kalibr": _kalibr,
}
