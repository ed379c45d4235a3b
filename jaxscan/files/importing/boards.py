"""A board as people write it: "chessboard 11x6 13mm"."""

import re

from jaxscan.errors import OptionError
from jaxscan.files.capture import BoardTable
from jaxscan.files.disk import FileModel, check


_FORMS = {
    "chessboard": ("square_mm",),
    "charuco": ("square_mm", "marker_mm"),
    "circles": ("spacing_mm", "diameter_mm"),
    "aprilgrid": ("tag_mm", "gap_mm"),
}
_EXAMPLES = (
    '"chessboard 11x6 13mm" (inner corners, square), "charuco 12x9 30mm 22mm DICT_5X5_250" (squares, square, marker; '
    "with the word legacy behind where OpenCV before 4.6 printed it), "
    '"circles 4x11 20mm 16mm" (circles, distance of rows, diameter; with the word symmetric behind where no row is '
    'shifted) or "aprilgrid 6x6 24mm 7.2mm" (tags, tag, gap)'
)
_LAYOUTS = ("legacy", "standard")
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


class _Given(FileModel):
    board: BoardTable


def parse_board(text: str) -> BoardTable:
    """The board that a text describes: its kind, its columns and rows, and its lengths.

    Raises:
        OptionError: If it is understood as none.
    """
    words = re.sub(r"(?<=[0-9]) +(?=(?:mm|cm|m)\b)", "", text[:200]).split()
    kind = words[0].lower() if words else ""
    counts = re.fullmatch(r"([0-9]{1,6})[xX×]([0-9]{1,6})", words[1]) if len(words) > 1 else None
    lengths = [re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)(mm|cm|m)", word) for word in words[2:]]
    known = [length for length in lengths if length]
    rest = [word for word, length in zip(words[2:], lengths, strict=True) if not length]
    # Each word behind the lengths says one thing.
    more = {"charuco": ("dictionary", "layout"), "circles": ("layout",)}.get(kind, ())
    words_of = {
        "layout" if word.lower() in _LAYOUTS or "dictionary" not in more else "dictionary": word for word in rest
    }
    understood = len(words_of) == len(rest) and set(words_of) <= set(more)
    if kind not in _FORMS or counts is None or len(known) != len(_FORMS[kind]) or not understood:
        raise OptionError(f"--board: found {text[:80]!r}, expected {_EXAMPLES}.")
    table = {"type": kind, "columns": int(counts[1]), "rows": int(counts[2])}
    table |= {key: float(hit[1]) * _UNITS[hit[2]] for key, hit in zip(_FORMS[kind], known, strict=True)}
    table |= {key: word.lower() if key == "layout" else word for key, word in words_of.items()}
    return check(_Given, {"board": table}, name="--board", error=OptionError).board
