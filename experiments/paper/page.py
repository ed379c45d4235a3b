"""The page of results: the paper's figures beside those of both worlds.

    python -m experiments.paper.page [--quick] FOLDER

Takes the figures that `python -m experiments.paper --out FOLDER` wrote. Writes experiments/results/paper.md and the
table in experiments/README.md; with `--quick` it only prints them.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

from experiments.paper.contents import EXPERIMENTS, results_path
from experiments.paper.metrics import Metric, shown
from experiments.paper.worlds import WORLDS


ROOT = Path(__file__).resolve().parents[1]
PAGE, README = ROOT / "results" / "paper.md", ROOT / "README.md"
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


def rows_of(worlds: dict[str, dict[str, Any]], name: str) -> list[Row]:
    """Figures of an experiment, in the order of the first world that has them."""
    found: dict[str, dict[str, Metric]] = {}
    for each, results in worlds.items():
        for fields in results.get(name, {}).get("metrics", ()):
            found.setdefault(fields["key"], {})[each] = Metric(**fields)
    return [Row(metrics) for metrics in found.values()]


def table(rows: list[Row]) -> list[str]:
    """Lines of a table."""
    head = ["figure", "unit", "paper", *(f"{name} world" for name in WORLDS), "must reach"]
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *(row.cells() for row in rows))]


def page(worlds: dict[str, dict[str, Any]]) -> str:
    """The whole page."""
    lines = [HEAD]
    for name in EXPERIMENTS:
        if not (rows := rows_of(worlds, name)):
            continue
        seconds = [f"{world} {results[name]['seconds']:.0f} s" for world, results in worlds.items() if name in results]
        lines += [f"## {name}", f"`python -m experiments.paper {name}` ({', '.join(seconds)})", "", *table(rows), ""]
    return "\n".join(lines)


def headline(worlds: dict[str, dict[str, Any]]) -> list[str]:
    """Figures that the paper reports, or that have a limit."""
    rows = [row for name in EXPERIMENTS for row in rows_of(worlds, name)]
    return table([row for row in rows if any(one.paper is not None or one.wanted() for one in row.metrics.values())])


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--quick", action="store_true")
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
