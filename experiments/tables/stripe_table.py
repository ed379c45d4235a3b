"""Figures of stripe extraction with their limits, as tables and as a plot."""

import os
import platform
from pathlib import Path
from typing import NamedTuple

import matplotlib


matplotlib.use("agg")

import numpy as np
from matplotlib import pyplot as plt


class Figure(NamedTuple):
    """A measured number and its limits [low, high], if any."""

    key: str
    value: float
    unit: str
    low: float | None = None
    high: float | None = None

    def holds(self) -> bool:
        """Whether the number is within its limits; NaN is not."""
        at_least = self.low is None or self.value >= self.low
        return at_least and (self.high is None or self.value <= self.high)


MORE = ("_valid", "_within_1px", "_right", "_right_of_all", "_found_on_clean_frames")
"""Ends of the keys of figures that are better where they are larger; of most others less is better."""
SCENE = ("_bound", "_at_the_bound", "_limit", "_rows", "_affected")
"""Ends of the keys of figures of the frames, which no code changes; those "over" one of them are of the code."""
WORSE = 0.02
"""Part of itself by which a figure may be worse."""


def change(key: str, before: float, now: float) -> float:
    """How much worse a figure is than it was, as a part of what it was; negative: better; infinite: was zero.

    The sigma over the error is worse where it is farther from 1.
    """
    if (key.endswith(SCENE) and "_over_" not in key) or now == before:
        return 0.0
    if "_sigma_over_error" in key:
        return (abs(now - 1.0) - abs(before - 1.0)) / before
    worse = before - now if key.endswith(MORE) else now - before
    return worse / before if before > 0 else float(np.sign(worse)) * np.inf


def against_lines(figures: list[Figure], before: dict[str, float]) -> tuple[list[str], list[str]]:
    """A Markdown table of the figures that changed by more than `WORSE`, and the keys of those that are worse."""
    out = ["| figure | before | now | worse by | |", "|---|---:|---:|---:|---|"]
    worse = []
    for figure in figures:
        if figure.key not in before:
            continue
        by = change(figure.key, before[figure.key], figure.value)
        if not abs(by) <= WORSE:
            worse += [figure.key] if not by <= WORSE else []
            out.append(
                f"| {figure.key} | {before[figure.key]:.5g} | {figure.value:.5g} | {100 * by:+.1f} % | "
                f"{'' if by <= WORSE else 'WORSE'} |"
            )
    return out, worse


class Cell(NamedTuple):
    """One width and amplitude, with one kind of noise model."""

    width: float
    amplitude: float
    noise: str
    rows: int
    valid: float
    bound: float
    rms: float
    bias: float
    """Largest mean error of a phase bin [px]."""
    bias_error: float
    """Largest standard error of a bin's mean [px]."""
    honesty: float
    """Reported sigma over true error, both root mean square."""

    @property
    def ratio(self) -> float:
        return self.rms / self.bound


def cell_figures(cells: list[Cell], section: str) -> list[Figure]:
    """The figures of each cell, with their limits."""
    out = []
    for cell in cells:
        key = f"{section}_{cell.width:g}px_{cell.amplitude:g}dn_{cell.noise}"
        out.append(Figure(f"{key}_valid", cell.valid, "of rows"))
        out.append(Figure(f"{key}_sigma_over_error", cell.honesty, "1", 0.9, 1.1))
        if section == "over_exposed":
            out.append(Figure(f"{key}_rms", cell.rms, "px", high=0.02))
            out.append(Figure(f"{key}_rms_over_bound", cell.ratio, "1"))
        else:
            out.append(Figure(f"{key}_rms_over_bound", cell.ratio, "1", high=1.10 if section == "narrow" else 1.05))
        out.append(Figure(f"{key}_bias", cell.bias, "px", high=0.005 if section == "cells" else None))
    return out


def cell_lines(cells: list[Cell], section: str) -> list[str]:
    """A Markdown table: a row per cell, both noise models side by side."""
    out = [
        "| width px | amplitude DN | rows | bound px | valid | RMS px | RMS/bound | bias px | ± px | sigma/error | |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    pairs = zip(cells[::2], cells[1::2], strict=True)
    for known, estimated in pairs:
        both = [f"{getattr(known, name):{form}}, {getattr(estimated, name):{form}}" for name, form in _COLUMNS]
        holds = all(figure.holds() for figure in cell_figures([known, estimated], section))
        out.append(
            f"| {known.width:g} | {known.amplitude:g} | {known.rows} | {known.bound:.4f} | "
            f"{' | '.join(both[:4])} | {known.bias_error:.4f} | {both[4]} | {'' if holds else 'MISSED'} |"
        )
    return out


_COLUMNS = (("valid", ".4f"), ("rms", ".4f"), ("ratio", ".3f"), ("bias", ".4f"), ("honesty", ".3f"))


def figure_lines(figures: list[Figure]) -> list[str]:
    """A Markdown table of figures."""
    out = ["| figure | value | unit | asked | |", "|---|---:|---|---|---|"]
    for figure in figures:
        limits = [f"{sign} {limit:g}" for sign, limit in (("≥", figure.low), ("≤", figure.high)) if limit is not None]
        text = f"{figure.value:.0f}" if figure.unit.endswith("rows") and figure.value > 1 else f"{figure.value:.4g}"
        verdict = "" if figure.holds() else "MISSED"
        out.append(f"| {figure.key.replace('_', ' ')} | {text} | {figure.unit} | {' and '.join(limits)} | {verdict} |")
    return out


def draw(cells: list[Cell], path: Path) -> None:
    """Error over bound, and honesty of sigma, over width and amplitude; the noise known."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    panels = (
        ("ratio", "RMS error / Cramér–Rao bound", (1.05,)),
        ("bias", "largest bias over the phase [px]", (0.005,)),
        ("honesty", "reported sigma / true error", (0.9, 1.1)),
    )
    amplitudes = sorted({cell.amplitude for cell in cells})
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, len(amplitudes)))
    for axis, (name, title, limits) in zip(axes, panels, strict=True):
        for amplitude, colour in zip(amplitudes, colours, strict=True):
            chosen = [cell for cell in cells if cell.amplitude == amplitude and cell.noise == "known"]
            values = [getattr(cell, name) for cell in chosen]
            axis.plot(
                [cell.width for cell in chosen], values, "o-", ms=3, lw=1, color=colour, label=f"{amplitude:g} DN"
            )
        for limit in limits:
            axis.axhline(limit, color="tab:red", ls="--", lw=1)
        axis.set(title=title, xlabel="width (standard deviation) [px]")
        axis.grid(alpha=0.3)
    axes[0].axhline(1.0, color="0.4", lw=1)
    axes[1].set_ylim(bottom=0)
    axes[0].legend(fontsize="small", title="amplitude")
    figure.savefig(path, dpi=80)
    plt.close(figure)


def processor() -> str:
    """Name of the processor, and its number of cores."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores"
