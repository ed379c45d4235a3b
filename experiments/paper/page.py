"""The page of results: the paper's figures beside those of both worlds.

    python -m experiments.paper.page [--quick] FOLDER

Takes the figures that `python -m experiments.paper --out FOLDER` wrote. Writes experiments/results/paper.md and the
table in experiments/README.md; with `--quick` it only prints them.
"""

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

from experiments import report
from experiments.paper.stage import EXPERIMENTS, WORLDS, Metric, results_path, shown


ROOT = Path(__file__).resolve().parents[1]
PAGE, README = ROOT / "results" / "paper.md", ROOT / "README.md"
HEADLINES = (
    *(f"table_1.{way}_{key}_mean" for way in ("paper_way", "ours") for key in ("fx", "fy", "cx", "cy")),
    *(
        f"table_1.{way}_length_{size}_{part}"
        for way in ("paper_way", "ours")
        for size in (3820, 6150)
        for part in ("bias", "spread")
    ),
    *(f"table_1.our_protocol_length_{size}_rms" for size in (3820, 6150)),
    *(f"table_2.{way}_{key}_mean" for way in ("paper_way_linear", "paper_way_total", "ours") for key in "abc"),
    *(f"figure_7.{way}_picked_std" for way in ("paper_way_gravity", "paper_way_highest", "ours")),
    *(f"figure_9.{way}_{side}" for way in ("ours_boards", "ours_recalibrated") for side in ("width", "length")),
    *(f"figure_9.paper_way_gravity_{side}_{part}" for side in ("width", "length") for part in ("median", "rms")),
    *(f"figure_9.pair_angle_for_{side}{kind}" for side in ("width", "length") for kind in ("", "_rms")),
    *(f"fisheye.{side}_error" for side in ("length", "width", "height")),
    *(f"peers.{way}_{side}" for way in ("ours", "horus", "tuned") for side in ("width", "length", "rows")),
)
"""Figures without a limit that the table in the README shows too."""
BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"
HEAD = """# The paper's tables and figures

`make experiments` writes this page. Every figure comes from rendered images through the whole chain, unless its
experiment says otherwise; the truth is used in the comparison alone. **Bold**: the figure misses its limit.
"""


class Row(NamedTuple):
    """A figure in both worlds."""

    metrics: dict[str, Metric]
    """By world."""

    def cells(self) -> list[str]:
        """Of the table: figure, unit, paper, each world, wanted."""
        one = next(iter(self.metrics.values()))
        paper = "" if one.paper is None else f"{one.paper:.7g}"
        values = [value(self.metrics.get(name)) for name in WORLDS]
        return [one.label or one.key, one.unit, paper, *values, one.wanted()]


def value(metric: Metric | None) -> str:
    """A figure as the table shows it."""
    if metric is None:
        return ""
    text = shown(metric.value)
    return text if metric.met() else f"**{text}**"


def rows_of(worlds: dict[str, dict[str, Any]], name: str) -> dict[str, Row]:
    """Figures of an experiment by their keys, in the order of the first world that has them."""
    found: dict[str, dict[str, Metric]] = {}
    for each, results in worlds.items():
        for fields in results.get(name, {}).get("metrics", ()):
            found.setdefault(fields["key"], {})[each] = Metric(**fields)
    return {key: Row(metrics) for key, metrics in found.items()}


def table(rows: list[list[str]], *before: str) -> list[str]:
    """Lines of a table; `before` are the titles of columns before those of a `Row`."""
    head = [*before, "figure", "unit", "paper", *(f"{name} world" for name in WORLDS), "limit"]
    return report.table(head, rows).splitlines()


def page(worlds: dict[str, dict[str, Any]]) -> str:
    """The whole page."""
    lines = [HEAD]
    for name in EXPERIMENTS:
        if not (rows := rows_of(worlds, name)):
            continue
        seconds = [f"{world} {results[name]['seconds']:.0f} s" for world, results in worlds.items() if name in results]
        lines += [
            f"## {name}",
            f"`python -m experiments.paper {name}` ({', '.join(seconds)})",
            "",
            *table([row.cells() for row in rows.values()]),
            "",
        ]
    return "\n".join(lines)


def headline(worlds: dict[str, dict[str, Any]]) -> list[str]:
    """Figures that have a limit, and a few that are worth reading beside them."""
    limited = lambda row: any(one.wanted() for one in row.metrics.values())
    rows = [
        [name, *row.cells()]
        for name in EXPERIMENTS
        for key, row in rows_of(worlds, name).items()
        if f"{name}.{key}" in HEADLINES or limited(row)
    ]
    return table(rows, "experiment")


def main() -> int:
    """The command."""
    parser = report.command_line(__doc__, quick="small images and few draws, to see that all of it works")
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    paths = {name: results_path(options.folder, name, options.quick) for name in WORLDS}
    worlds = {name: json.loads(path.read_text()) for name, path in paths.items() if path.exists()}
    if not worlds:
        parser.error(f"{options.folder}: there are no figures; run `python -m experiments.paper` first")
    if options.quick:
        print(page(worlds))
        return 0
    PAGE.write_text(page(worlds))
    text = README.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    README.write_text(before + "\n".join([BEGIN, *headline(worlds), END]) + after)
    return 0


if __name__ == "__main__":
    sys.exit(main())
