"""The page of results: the paper's figures beside those of both worlds."""

from typing import Any

from experiments import report
from experiments.paper.stage import EXPERIMENTS, WORLDS, Metric, shown


PAGE = report.RESULTS / "paper.md"
HEAD = """# The paper's tables and figures

`make experiments` writes this page. Every figure comes from rendered images through the whole chain, unless its
experiment says otherwise; the truth is used in the comparison alone. **Bold**: the figure misses its limit. The worlds,
and what the figures do not show, are described in [the table of contents](../README.md#the-paper).

![The room of Fig. 9: ours without and with colour, and by the paper's method](paper/figure_9_kind.png)

*The room of Fig. 9 in the kind world, from 3600 steps. The camera of the paper sees 32° up and down.*

![Two objects, without and with colour](paper/figure_8_kind.png)

*Fig. 8: two textured objects at 1.3 m.*
"""


def page(worlds: dict[str, dict[str, Any]]) -> str:
    """The whole page, of the results of each world."""
    lines, head = [HEAD], ["figure", "unit", "paper", *(f"{name} world" for name in WORLDS), "limit"]
    for name in EXPERIMENTS:
        # Figures by their keys, in the order of the first world that has them.
        found: dict[str, dict[str, Metric]] = {}
        for world, results in worlds.items():
            for fields in results.get(name, {}).get("metrics", ()):
                found.setdefault(fields["key"], {})[world] = Metric(**fields)
        if not found:
            continue
        seconds = [f"{world} {results[name]['seconds']:.0f} s" for world, results in worlds.items() if name in results]
        lines += [f"## {name}", f"`python -m experiments.paper {name}` ({', '.join(seconds)})", ""]
        lines += [report.table(head, map(_cells, found.values())), ""]
    return "\n".join(lines)


def _cells(metrics: dict[str, Metric]) -> list[str]:
    """Cells of the table: figure, unit, paper, each world, wanted."""
    one = next(iter(metrics.values()))
    paper = "" if one.paper is None else f"{one.paper:.7g}"
    values = []
    for name in WORLDS:
        text = shown(metrics[name].value) if name in metrics else ""
        values.append(text if not text or metrics[name].met() else f"**{text}**")
    return [one.label or one.key, one.unit, paper, *values, one.wanted()]
