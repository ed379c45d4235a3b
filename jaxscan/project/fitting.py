"""The products that can be made of each capture: nobody wants the plan of a room from a table that carries a bust."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import CaptureError, ConfigError, JaxscanError
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME, CaptureHeader, open_capture, parse_header
from jaxscan.files.disk import MEGABYTE, open_regular, read_bounded
from jaxscan.files.remote import is_remote, read_remote
from jaxscan.project.config import CapturesTable, Name, Product, ProjectTable


UNFIT: Mapping[str, tuple[Product, ...]] = {
    "object": ("plan", "panorama"),
    "linear": ("panorama",),
    "nothing": ("mesh", "plan", "panorama"),
}
"""By the load of the table that a header names. A stage may move along the walls of a room, so its plan is tried."""
_OF_MANY: tuple[Product, ...] = ("mesh", "plan", "panorama")
"""Products of neighbouring profiles, which a single record has not."""
_WHY = {
    "object": "a table that carries the object turns no camera in a room",
    "linear": "a stage does not turn the camera",
    "nothing": "profiles of a scanner that stands still have no neighbours",
}
_SINGLE = "only one record"
_OTHER_LINES = 8
"""Lines of a journal that may be no records: a seal, events, a record that was taken twice."""
_MOST_NAMES = 3


class Fitting(NamedTuple):
    """The products of the captures of one table."""

    products: Mapping[Name, tuple[Product, ...]]
    """Of each capture, by its name."""
    notes: tuple[str, ...]
    """A sentence for all captures of which the same is left out."""


def fitting_products(
    path: str | Path,
    table: CapturesTable,
    wanted: ProjectTable,
    captures: Mapping[Name, str],
    headers: Mapping[str, CaptureHeader],
) -> Fitting:
    """The products of captures, without those that cannot be made of them.

    A header is read only if something may be left out, and never for this alone from storage.

    Args:
        path: The project's file, for messages.
        table: Of the captures.
        wanted: What the whole project has.
        captures: Addresses, by name.
        headers: Those that were read before, by address.

    Raises:
        ConfigError: If the table itself asks for a product that can be made of none of its captures.
    """
    asked = wanted.products if table.products is None else table.products
    if not set(asked) & set(_OF_MANY):
        return Fitting(dict.fromkeys(captures, asked), ())
    products: dict[Name, tuple[Product, ...]] = {}
    left: dict[tuple[str, tuple[Product, ...]], list[Name]] = defaultdict(list)
    for name, address in captures.items():
        why, unfit = _unfit(address, table.settings.every, headers.get(address))
        gone = tuple(kind for kind in asked if kind in unfit)
        products[name] = tuple(kind for kind in asked if kind not in gone)
        if gone:
            left[why, gone].append(name)
    never = tuple(kind for kind in asked if not any(kind in some for some in products.values()))
    # A header's word on the rig stays as it is, but a sweep of one record may be one that goes on.
    if table.products is not None and never and all(why in UNFIT for why, _ in left):
        raise ConfigError(
            f'{path}: captures "{table.pattern}": {_and(never)} cannot be made of {_some(tuple(captures))}: '
            f"{_said(next(iter(left))[0])}. {_instead(asked, never)}"
        )
    notes = []
    for (why, gone), names in left.items():
        more = f" {_instead(asked, gone)}" if why in UNFIT and len(names) == len(captures) else ""
        notes.append(f'captures "{table.pattern}": no {_and(gone, "or")} of {_some(names)}: {_said(why)}.{more}')
    return Fitting(products, tuple(notes))


def _unfit(address: str, every: int, header: CaptureHeader | None) -> tuple[str, tuple[Product, ...]]:
    """The word that says why some products cannot be made of a capture, and those; none if it cannot be read."""
    try:
        if header is None and not is_remote(address):
            header = header_of(address)
        carries = None if header is None or header.turntable is None else header.turntable.carries
        if carries in UNFIT:
            return str(carries), UNFIT[str(carries)]
        if not is_remote(address) and _is_single(address, every):
            return _SINGLE, _OF_MANY
    except JaxscanError:
        # Said by the step that makes its cloud; other captures go on.
        pass
    return "", ()


def header_of(address: str) -> CaptureHeader:
    """The header of a capture on this disk or on storage.

    Raises:
        JaxscanError: If it cannot be read.
    """
    name = f"{address}/{HEADER_NAME}"
    text = read_remote(name, MEGABYTE) if is_remote(address) else read_bounded(name, MEGABYTE, error=ConfigError)
    return parse_header(text, name=name)


def _is_single(folder: str, every: int) -> bool:
    """Whether one record is taken of a capture. Only a journal that is short enough for that is read as one."""
    if is_longer(Path(folder), every + _OTHER_LINES):
        return False
    return len(open_capture(folder, compare=False).every(every)) == 1


def is_longer(folder: Path, records: int) -> bool:
    """Whether a journal has more lines; counting them takes less time than reading them."""
    lines = 0
    with open_regular(folder / JOURNAL_NAME, error=CaptureError) as file:
        while lines <= records and (block := file.read(MEGABYTE)):
            lines += block.count(b"\n")
    return lines > records


def _said(why: str) -> str:
    return f'{HEADER_NAME} says carries = "{why}", and {_WHY[why]}' if why in _WHY else why


def _instead(asked: Iterable[Product], gone: Iterable[Product]) -> str:
    """The line to write, so that no more is asked for than there can be."""
    left = [f'"{kind}"' for kind in asked if kind not in gone] or ['"cloud"']
    return f"Write products = [{', '.join(left)}] there."


def _and(words: Sequence[str], last: str = "and") -> str:
    return f" {last} ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _some(names: Sequence[str]) -> str:
    more = [f"{len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else []
    return _and([*names[:_MOST_NAMES], *more])
