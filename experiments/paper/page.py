"""The page of results: the paper's figures beside those of both worlds.

    python -m experiments.paper.page [--quick] FOLDER

Takes the figures that `python -m experiments.paper --out FOLDER` wrote, and writes experiments/results/paper.md; with
`--quick` it prints the page.
"""

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

from experiments import report
from experiments.paper.stage import EXPERIMENTS, WORLDS, Metric, results_path, shown


PAGE = report.RESULTS / "paper.md"
HEAD = """# The paper's tables and figures

`make experiments` writes this page. Every figure comes from rendered images through the whole chain, unless its
experiment says otherwise; the truth is used in the comparison alone. **Bold**: the figure misses its limit. The worlds,
and what the figures do not show, are described in [the table of contents](../README.md#the-paper).

![The room of Fig. 9 from above: ours without and with colour, and by the paper's method](paper/figure_9_kind.png)

*The room of Fig. 9 in the kind world, from 3600 steps.*

![The four walls of the room, without and with colour](paper/figure_9_sides_kind.png)

*Its walls from within. The camera of the paper sees 32° up and down.*

![Two objects, without and with colour](paper/figure_8_kind.png)

*Fig. 8: two textured objects at 1.3 m.*
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


def page(worlds: dict[str, dict[str, Any]]) -> str:
    """The whole page."""
    lines, head = [HEAD], ["figure", "unit", "paper", *(f"{name} world" for name in WORLDS), "limit"]
    for name in EXPERIMENTS:
        if not (rows := rows_of(worlds, name)):
            continue
        seconds = [f"{world} {results[name]['seconds']:.0f} s" for world, results in worlds.items() if name in results]
        lines += [
            f"## {name}",
            f"`python -m experiments.paper {name}` ({', '.join(seconds)})",
            "",
            report.table(head, [row.cells() for row in rows.values()]),
            "",
        ]
    return "\n".join(lines)


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
    else:
        PAGE.write_text(page(worlds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
