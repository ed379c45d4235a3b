"""The speed experiment as a picture."""

from pathlib import Path

from matplotlib.figure import Figure


OWN, OTHER, BOUND, STAGE = "#1f6f8b", "#b8b8b8", "#e0a458", "#7fb7be"


def draw(path: Path, contestants: list[tuple[str, float]], stages: list[tuple[str, float]]) -> None:
    """Bars of ms/pair on a logarithmic axis: the slowest contestant on top, then the stages of ours."""
    ordered = sorted(contestants, key=lambda bar: -bar[1])
    bars = [(name, time, _colour(name)) for name, time in ordered]
    bars += [(f"ours: {name}", time, STAGE) for name, time in stages]
    figure = Figure(figsize=(8.0, 0.36 * len(bars) + 1.3), layout="constrained")
    axes = figure.subplots()
    place = range(len(bars))
    axes.barh(place, [time for _, time, _ in bars], color=[colour for *_, colour in bars])
    for at, (_, time, _) in zip(place, bars, strict=True):
        axes.annotate(f"{time:.3g}", (time, at), (4, 0), textcoords="offset points", va="center", fontsize=9)
    axes.set_yticks(list(place), [name for name, *_ in bars])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlim(0.4 * min(time for _, time, _ in bars), 2.0 * max(time for _, time, _ in bars))
    axes.xaxis.set_major_formatter(lambda time, _: f"{time:g}")
    axes.set_xlabel("ms per pair of 1280 x 1024, two cores")
    axes.set_title("Frames in memory to coloured points (grey: others, amber: bounds)", fontsize=10, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def _colour(name: str) -> str:
    if name.startswith("ours"):
        return OWN
    return BOUND if name in ("fused", "read") else OTHER
