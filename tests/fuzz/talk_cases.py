"""Orders of pages. What a gate and a controller may be told is tested in tests/web and tests/hardware."""

import json
import random

from .draft import Case, Draft
from .nasty import nasty_text, nasty_value
from .texts import change_bytes


_ORDERS = ("stop", "take over", "pause", "aim", "sweep", "boards", "take", "enough", "calibrate", "reconstruct")
_ORDERS += ("compare", "lost", "choose", "undo", "clear", "cancel", "remove", "save", "room", "pick")
_FIELDS = ("name", "other", "resume", "stop", "what", "id", "origin", "direction", "cone_rad", "clouds", "section")
_FIELDS += ("turn_rad", "backs", "page")


def _order(rng: random.Random) -> str:
    order = {"do": rng.choice(_ORDERS) if rng.random() < 0.9 else nasty_value(rng)}
    for field in rng.sample(_FIELDS, rng.randrange(6)):
        order[field] = rng.choice(
            (nasty_value(rng), nasty_text(rng), [1.0, 0.0, 0.5], [[0, 0, 0], [1, 1, 1]], 0.01, True, "room", 1)
        )
    if rng.random() < 0.3:
        order["clouds"] = [{"number": rng.choice((0, 1, -1, 2**70, None)), "shift": [0, 0, rng.choice((0, "x"))]}]
    text = json.dumps(order)
    if rng.random() < 0.2:
        text = change_bytes(rng, text.encode(errors="replace")).decode("utf-8", "replace")
    return rng.choice((text, text, text, "[" * 4000, "9" * 5000, f'{{"do": {text}}}'))


def orders_case(draft: Draft) -> Case:
    """Some orders to both parsers: an order or one line."""
    texts = [_order(draft.rng) for _ in range(20)]

    def drive() -> list[str]:
        from jaxscan.cli.console.orders import parse_order as of_console
        from jaxscan.errors import JaxscanError
        from jaxscan.viewer.orders import parse_order as of_viewer

        faults = []
        for text in texts:
            for parse in (of_console, lambda text: of_viewer(text, 2)):
                try:
                    parse(text)
                except JaxscanError as problem:
                    faults += ["lines"] if "\n" in str(problem) else []
        return faults

    return Case("orders", [], drive=drive)
