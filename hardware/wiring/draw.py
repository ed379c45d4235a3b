"""Draws `wiring.toml` as SVG: `python hardware/wiring/draw.py docs/hardware/wiring.svg`."""

import sys
import tomllib
from html import escape
from pathlib import Path


SOURCE = Path(__file__).with_name("wiring.toml")
WIDTH, ROW, TOP = 980, 34, 64
CHIP = (30, 190)
"""Left edge and width of the controller."""
PARTS = (560, 390)
"""Left edge and width of the parts."""
STYLE = (
    "text{font:13px 'DejaVu Sans',Verdana,sans-serif;fill:#1c2530}.small{font-size:11px;fill:#5b6672}"
    ".title{font-size:15px;font-weight:bold}.box{fill:#f4f6f8;stroke:#5b6672}"
    ".wire{stroke:#0072b2;stroke-width:1.8;fill:none}.power{stroke:#d55e00;stroke-width:2.2;fill:none}"
)


def drawing(source: Path = SOURCE) -> str:
    """The SVG of a list of pins: the controller at the left, a wire for each pin, the chain of the supply below."""
    wiring = tomllib.loads(source.read_text(encoding="utf-8"))
    pins, supply = wiring["pin"], wiring["supply"]
    bottom = TOP + ROW * len(pins)
    body = [_text(CHIP[0], 28, wiring["title"], "title"), _box(CHIP[0], TOP - 14, CHIP[1], ROW * len(pins) + 8)]
    for number, pin in enumerate(pins):
        body += _pin(pin, TOP + ROW * number + 8)
    for part, first, count in _groups(pins):
        top = TOP + ROW * first - 10
        body.append(_box(PARTS[0], top, PARTS[1], ROW * count - 4))
        # The name stands over the last column, once for each part.
        body.append(_text(PARTS[0] + PARTS[1] - 10, top + ROW * count / 2 + 3, part, anchor="end"))
    body += _supply(supply, bottom + 46)
    height = bottom + 200
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" '
        f'aria-label="Wiring of the controller"><style>{STYLE}</style>'
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>\n' + "\n".join(_in_order(body)) + "\n</svg>\n"
    )


def _pin(pin: dict[str, str], y: float) -> list[str]:
    start, end = CHIP[0] + CHIP[1], PARTS[0]
    tip = f"M{end - 9},{y - 4} l8,4 l-8,4" if pin["way"] == "out" else f"M{start + 9},{y - 4} l-8,4 l8,4"
    made = [
        _text(CHIP[0] + 10, y + 4, pin["name"]),
        _text(start - 10, y + 4, f"{pin['uno']} · {pin['chip']}", "small", anchor="end"),
        f'<path class="wire" d="M{start},{y} H{end} {tip}"/>',
        _text(end + 10, y + 4, pin["terminal"], "small"),
    ]
    if "through" in pin:
        made.append(_text((start + end) / 2, y - 5, pin["through"], "small", anchor="middle"))
    return made


def _supply(supply: dict, y: float) -> list[str]:
    chain = supply["chain"]
    half = (len(chain) + 1) // 2
    cell, high = (WIDTH - 60) / half, 34
    made = [_text(CHIP[0], y, supply["title"], "title")]
    for row, names in enumerate((chain[:half], chain[half:])):
        top = y + 16 + row * (high + 22)
        for column, name in enumerate(names):
            left = CHIP[0] + column * cell
            made += [_box(left, top, cell - 26, high), _text(left + (cell - 26) / 2, top + 21, name, "small", "middle")]
            if column + 1 < len(names):
                made.append(f'<path class="power" d="M{left + cell - 26},{top + high / 2} h26"/>')
    # From the end of the first row to the beginning of the second.
    right, middle = CHIP[0] + half * cell - 26, y + 16 + high + 11
    turn = f"M{right - 40},{y + 16 + high} V{middle} H{CHIP[0] + 40} V{middle + 11}"
    made += [f'<path class="power" d="{turn}"/>', _text(CHIP[0], y + 16 + 2 * high + 44, supply["note"], "small")]
    return made


def _groups(pins: list[dict[str, str]]) -> list[tuple[str, int, int]]:
    """Parts with their first pin and how many pins follow each other to the same part."""
    found: list[tuple[str, int, int]] = []
    for number, pin in enumerate(pins):
        if found and found[-1][0] == pin["part"]:
            found[-1] = (pin["part"], found[-1][1], found[-1][2] + 1)
        else:
            found.append((pin["part"], number, 1))
    return found


def _in_order(body: list[str]) -> list[str]:
    """Boxes first, so that no text is behind one."""
    return sorted(body, key=lambda element: not element.startswith("<rect"))


def _box(x: float, y: float, width: float, height: float) -> str:
    return f'<rect class="box" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="4"/>'


def _text(x: float, y: float, text: str, style: str = "", anchor: str = "start") -> str:
    kind = f' class="{style}"' if style else ""
    return f'<text{kind} x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>'


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(drawing(), encoding="utf-8")
