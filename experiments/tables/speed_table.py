"""Tables and plot of the speed experiment."""

import json
from pathlib import Path
from typing import NamedTuple

from measuring.speed_codecs import CodecRow
from measuring.speed_stages import Stage
from measuring.speed_times import Contestant, Figure
from tables.speed_plot import draw


class Found(NamedTuple):
    """All that was measured; empty lists where a section was left out."""

    rows: list[Contestant]
    steps: list[Stage]
    codecs: list[CodecRow]
    figures: list[Figure]


def write_results(folder: Path, about: dict[str, str], found: Found, pairs: int) -> None:
    """`speed.md`, `speed.json` and `speed.png`."""
    rows, steps, codecs, figures = found
    folder.mkdir(exist_ok=True)
    bandwidth = next((figure.value for figure in figures if figure.key == "bandwidth"), None)
    parts = [_head(about, pairs), _asked(figures)]
    if rows:
        parts.append(_contestants(rows))
    if steps:
        parts.append(_stages(steps, bandwidth))
    if codecs:
        parts.append(_codecs(codecs))
    parts.append(_rest(figures))
    (folder / "speed.md").write_text("\n".join(parts))
    document = {"format": "jaxscan-experiment-speed/1", **about, "metrics": [figure._asdict() for figure in figures]}
    (folder / "speed.json").write_text(json.dumps(document, indent=1) + "\n")
    if rows:
        bars = [(row.name, 1e3 * row.times.best) for row in rows]
        draw(folder / "speed.png", bars, [(step.name, 1e3 * step.times.best) for step in steps])


def _head(about: dict[str, str], pairs: int) -> str:
    return f"""# Speed of a reconstruction

Written by `python experiments/speed.py`; {about["date"]}.

- Processor: {about["processor"]}; load average {about["load"]} at the start, {about["load_at_end"]} at the end
- {about["versions"]}
- Frames: 1280 x 1024, 8 bit, on and off, a room with texture, noise, depth steps, stripes of 20 to 200 DN,
  rows without a stripe and rows with two; {pairs} pairs in memory, the same for all, contestants in turn
- Best run of several, and the median; compilation excluded
"""


def _table(head: list[str], lines: list[list[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows) + "\n"


def _asked(figures: list[Figure]) -> str:
    lines = []
    for figure in figures:
        if figure.asked is not None:
            sign = "<=" if figure.direction == "lower" else ">="
            unit = "" if figure.unit == "1" else f" {figure.unit}"
            verdict = "yes" if figure.met() else "**no**"
            lines.append([figure.key, f"{figure.value:.3g}{unit}", f"{sign} {figure.asked:g}{unit}", verdict])
    return "## Limits\n\n" + _table(["figure", "found", "limit", "met"], lines)


def _contestants(rows: list[Contestant]) -> str:
    own = next(row.times.best for row in rows if row.name == "ours")
    lines = []
    for row in rows:
        shares = ["" if share is None else f"{100 * share:.1f} %" for share in (row.points, row.right)]
        times = [f"{1e3 * t:.3f}" for t in row.times]
        lines.append([row.name, row.gives, *times, f"{row.times.best / own:.2f}", *shares])
    head = ["", "gives", "best, ms/pair", "median", "processor", "over ours", "lines with a point", "stripes found"]
    text = """## From frames in memory

"Processor" is the time of both cores together. "Lines with a point" counts all lines of all pairs, points on
reflections too; "stripes found" are the stripes drawn whose centre was found within 1 px.

"""
    return text + _table(head, lines)


def _stages(steps: list[Stage], bandwidth: float | None) -> str:
    lines = []
    for step in steps:
        rate = step.pair_bytes / step.times.best / 1e9
        share = "" if bandwidth is None else f"{100 * rate / bandwidth:.0f} %"
        times = [f"{1e3 * t:.3f}" for t in step.times]
        lines.append([step.name, *times, f"{step.pair_bytes / 1e6:.2f}", f"{rate:.1f}", share, step.bound])
    head = ["stage", "best, ms/pair", "median", "processor", "MB/pair", "GB/s", "of a plain read", "bound by"]
    return "## Ours, stage by stage\n\n" + _table(head, lines)


def _codecs(codecs: list[CodecRow]) -> str:
    lines = []
    for row in codecs:
        times = [f"{1e3 * t:.2f}" for t in (row.encode, row.decode, row.decode_all_cores)]
        lines.append([row.codec, row.frames, f"{100 * row.size:.1f} %", *times])
    head = ["codec", "frames", "size", "encode, ms on one core", "decode", "decode, ms on all cores"]
    text = """## Lossless codecs

Of a frame; what comes back is compared. Differences of frames are taken modulo 256.

"""
    return text + _table(head, lines)


def _rest(figures: list[Figure]) -> str:
    lines = [[figure.key, f"{figure.value:.4g}", "" if figure.unit == "1" else figure.unit] for figure in figures]
    return "## All figures\n\n" + _table(["figure", "value", "unit"], lines)
