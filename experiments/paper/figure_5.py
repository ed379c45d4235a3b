"""Figure 5: the stripe on a board: laser off, laser on, their difference, and centres in enlarged details.

The boards of Fig. 6 that no calibration has seen. The paper does not say how it found the stripe; the two plain finders
are a centre of gravity and the highest pixel. Our stripe is that of a calibration, which knows the print, and that of a
sweep, which does not. The true centre, where the middle of the sheet of light meets the board, serves the comparison
alone.
"""

from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.methods import EXTRACTORS, METHODS, board_pose, find_board, stripe_on_board
from experiments.paper.products import draws, held_out, observe_held_out
from experiments.paper.stage import Direction, Metric, Stage, plt, save


WAYS = {"ours": "ours, as in a calibration", "ours_sweep": "ours, as in a sweep", **METHODS}
"""Stripe finders."""
_STYLES = {
    "highest": {"marker": "s", "ms": 7, "mfc": "none", "color": "tab:orange"},
    "gravity": {"marker": "x", "ms": 6, "color": "deepskyblue"},
    "ours": {"marker": "o", "ms": 4, "color": "lime"},
}


class SeenStripe(NamedTuple):
    """One board with its stripe."""

    on: np.ndarray
    """Laser-on frame, uint8 [rows, columns]."""
    off: np.ndarray
    """Laser-off frame."""
    true: np.ndarray
    """The true centre of every row [rows], px; NaN without one."""
    found: dict[str, np.ndarray]
    """By stripe finder: centres of every row on the board [rows], px; NaN without one."""


def run(stage: Stage) -> list[Metric]:
    """Errors of centres [px] by every stripe finder, at the rows of the plain finders."""
    boards = look(stage)
    metrics = []
    plain = [np.isfinite(board.found["gravity"]) for board in boards]
    for way, label in WAYS.items():
        error = np.concatenate([(b.found[way] - b.true)[rows] for b, rows in zip(boards, plain, strict=True)])
        direction: Direction = "less" if way.startswith("ours") else "near"
        # Rows at the edges of squares dominate the root mean square and hardly change the median.
        whole, middle = float(np.sqrt(np.nanmean(error**2))), float(np.nanmedian(np.abs(error)))
        words = f"{label}: %s error of stripe centres on white squares"
        metrics += [
            Metric(f"{way}_rms", whole, "px", direction, 0.15 * whole, label=words % "rms"),
            Metric(f"{way}_median", middle, "px", direction, 0.15 * middle, label=words % "median absolute"),
        ]
    for way in ("ours_sweep", "gravity"):
        shares = [np.isfinite(board.found[way][_span(board)]).mean() for board in boards]
        words = f"{WAYS[way]}: rows of the board with a stripe centre"
        direction = "more" if way.startswith("ours") else "near"
        metrics.append(Metric(f"{way}_rows", 100 * float(np.mean(shares)), "%", direction, 3, label=words))
    _picture(stage, boards[0], metrics)
    return metrics


def look(stage: Stage) -> list[SeenStripe]:
    """All boards of the first draw, by every stripe finder."""
    given, draw = held_out(stage), draws(stage)[0]
    capture, way = jaxscan.open_capture(given.captures[0]), draw.paper
    observed = observe_held_out(draw.ours, given.captures[0])
    record_of = np.asarray(observed.corners.record)[np.asarray(observed.stripes.view)].tolist()
    boards = []
    for index in range(len(capture.records)):
        on, off = capture.frames(index)
        corners = find_board(off, capture.board.grid(), capture.board.square)
        if corners is None or index not in record_of:
            continue
        pose = board_pose(way.matrix, way.k, corners)
        stripes = jaxscan.extract_stripes(on, off)
        wide = np.asarray(stripes.u[0], np.float64), np.asarray(stripes.valid[0])
        everywhere = {name: extract(on, off) for name, extract in EXTRACTORS.items()} | {"ours_sweep": wide}
        outline = capture.board.outline()
        found = {
            name: _by_row(stripe_on_board(way.matrix, way.k, pose, outline, each), len(off))
            for name, each in everywhere.items()
        }
        row = record_of.index(index)
        kept = np.asarray(observed.stripes.valid[row])
        found["ours"] = _by_row(np.asarray(observed.stripes.q[row])[kept], len(off))
        true = np.where(given.true_valid[index], given.true_u[index], np.nan)
        boards.append(SeenStripe(on, off, true, found))
    return boards


def _by_row(uv: np.ndarray, rows: int) -> np.ndarray:
    """Centres [rows] of pixels (u, v) [n, 2] in whole rows; NaN without one."""
    out = np.full(rows, np.nan)
    out[np.rint(uv[:, 1]).astype(int)] = uv[:, 0]
    return out


def _span(board: SeenStripe) -> slice:
    """Rows from the first to the last on which any finder finds the stripe on the board."""
    rows = np.flatnonzero(np.any([np.isfinite(each) for each in board.found.values()], axis=0))
    return slice(rows[0], rows[-1] + 1)


def _details(board: SeenStripe) -> dict[str, int]:
    """Middle rows of the details: on a white square, across an edge, and on a black one, near the stripe's middle."""
    span = _span(board)
    rows = np.arange(span.start, span.stop)
    # No finder finds every row: the rows between are interpolated.
    known = np.isfinite(board.found["ours"][span])
    u = np.interp(rows, rows[known], board.found["ours"][span][known])
    beside = np.stack([board.off[rows, np.rint(u).astype(int) + step] for step in (-1, 0, 1)]).mean(0)
    white = beside > (np.percentile(beside, 10) + np.percentile(beside, 90)) / 2
    edges = np.flatnonzero(np.diff(white.astype(int))) + 1
    middles = (edges[:-1] + edges[1:]) // 2
    centre = len(rows) / 2

    def nearest(places: np.ndarray) -> int:
        return int(rows[places[np.argmin(np.abs(places - centre))]]) if len(places) else int(rows[len(rows) // 2])

    # Slivers between two edges are no squares.
    wide = np.diff(edges) > 0.5 * np.median(np.diff(edges)) if len(edges) > 1 else np.zeros(0, bool)
    return {
        "on a white square": nearest(middles[wide & white[middles]]),
        "across an edge": nearest(edges),
        "on a black square": nearest(middles[wide & ~white[middles]]),
    }


def _picture(stage: Stage, board: SeenStripe, metrics: list[Metric]) -> None:
    difference = board.on.astype(np.float64) - board.off
    figure = plt.figure(figsize=(15.5, 9.6), layout="constrained")
    axes = figure.subplots(2, 3, height_ratios=(0.78, 1.0))
    bright, ceiling = np.percentile(board.off, 99.9), np.percentile(difference, 99.95)
    images = {"laser off": (board.off, bright), "laser on": (board.on, bright), "difference": (difference, ceiling)}
    for place, (title, (image, high)) in zip(axes[0], images.items(), strict=True):
        shown = place.imshow(image, cmap="gray", vmin=0, vmax=high)
        place.set(title=title, xlabel="u [px]", ylabel="v [px]")
        figure.colorbar(shown, ax=place, label="DN", shrink=0.8)
    for number, (place, (name, row)) in enumerate(zip(axes[1], _details(board).items(), strict=True)):
        middle = _detail(place, board, difference, row)
        letter = "abc"[number]
        place.set_title(f"{letter}: difference {name}")
        # Beside the stripe, on both sides in turn, so that letters do not cover each other.
        aside = (0.12, 0.22, 0.32)[number] * difference.shape[1]
        arrow = {"arrowstyle": "->", "color": "yellow"}
        axes[0, 2].annotate(letter, (middle, row), (middle + aside, row), color="yellow", arrowprops=arrow, va="center")
    handles, labels = axes[1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    value = {metric.key: metric.value for metric in metrics}
    errors = [f"{words} {value[f'{way}_rms']:.3f} ({value[f'{way}_median']:.3f})" for way, words in WAYS.items()]
    text = "; ".join(errors[:2]) + "\n" + "; ".join(errors[2:])
    title = f"Figure 5, {stage.world} world: the stripe on a board at 1.3 m"
    figure.suptitle(f"{title}\nerrors on white squares of all boards, rms (median absolute) [px]: {text}", fontsize=10)
    save(figure, stage.picture("figure_5"), 120)


def _detail(place: plt.Axes, board: SeenStripe, difference: np.ndarray, row: int) -> int:
    """The difference around a row of the stripe, with all centres; returns the column in its middle."""
    rows = np.arange(max(0, row - 10), min(len(difference), row + 11))
    middle = round(float(np.nanmedian(np.concatenate([board.true[rows], board.found["ours"][rows]]))))
    columns = np.arange(max(0, middle - 11), min(difference.shape[1], middle + 12))
    part = difference[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    extent = (columns[0] - 0.5, columns[-1] + 0.5, rows[-1] + 0.5, rows[0] - 0.5)
    shown = place.imshow(part, cmap="gray", extent=extent, vmin=min(0, part.min()), vmax=part.max())
    place.figure.colorbar(shown, ax=place, label="DN", shrink=0.8)
    place.plot(board.true[rows], rows, "-", color="magenta", lw=1.2, label="true centre (comparison only)")
    for way, style in _STYLES.items():
        place.plot(board.found[way][rows], rows, ls="none", label=WAYS[way], **style)
    place.set(xlim=extent[:2], ylim=extent[2:], xlabel="u [px]", ylabel="v [px]")
    place.yaxis.get_major_locator().set_params(integer=True)
    return middle
