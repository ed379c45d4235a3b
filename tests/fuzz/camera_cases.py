"""Cameras of other programs, changed and cut, to the reader of them all."""

import json
import random
from pathlib import Path

from ..files.test_known_cameras import MRCAL, STRANGERS
from .draft import Case, Draft
from .nasty import nasty_number, nasty_text
from .texts import change_bytes, change_lines, change_tree, dump


def camera_case(draft: Draft) -> Case:
    """A camera in any of the forms, changed in bytes, lines or values; one line refuses what makes no sense."""
    rng = draft.rng
    suffix, data = _camera(rng)
    for _ in range(rng.choice((0, 1, 1, 2, 4))):
        data = rng.choice((change_bytes, change_lines, _other_value))(rng, data) if data else data
    path = draft.folder / f"camera{suffix}"
    path.write_bytes(data)

    def drive() -> list[str]:
        from jaxscan.errors import JaxscanError
        from jaxscan.files.calibration import read_camera

        try:
            read = read_camera(path, (1280, 800))
        except JaxscanError as problem:
            return ["lines"] if "\n" in str(problem) or len(str(problem)) > 2000 else []
        return ["lines"] if "\n" in read.note else []

    return Case("camera", [], drive=drive)


def _camera(rng: random.Random) -> tuple[str, bytes]:
    name, text, _ = rng.choice([*STRANGERS.values(), ("c.cameramodel", MRCAL, [])])
    if name.endswith(".json") and rng.random() < 0.7:
        return ".json", dump(change_tree(rng, json.loads(text)))
    return Path(name).suffix, text.encode()


def _other_value(rng: random.Random, data: bytes) -> bytes:
    """A word of the file is another one: a number, a bracket, any text."""
    words = data.split(b" ")
    other = rng.choice(
        (str(nasty_number(rng)), nasty_text(rng)[:200], "[", "]", "{", "}", "-", ":", "0,5", "09", ".inf")
    )
    words[rng.randrange(len(words))] = other.encode("utf-8", "replace")
    return b" ".join(words)
