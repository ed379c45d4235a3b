"""Output of a recalibration: as text for people, as JSON for machines."""

from dataclasses import asdict
from typing import Any

import numpy as np

from jaxscan.cli.process.terminal import Terminal
from jaxscan.files.calibration import finite
from jaxscan.recalibration import Recalibration
from jaxscan.report.recalibration import words


_STYLE = {"good": "bold green", "bad": "bold red", "open": "bold yellow"}
_UNUSUAL = 3.0
"""Changes beyond this many standard deviations are named."""


def print_recalibration(out: Terminal, result: Recalibration) -> None:
    """Print gains, moves, walls, closure and open directions, and the drift verdict last."""
    for text in words.table_lines(result):
        out.print(f"table: {text}", style="yellow")
    blocks = {
        "Uncertainty that the calibration alone causes (one standard deviation):": words.length_lines(result),
        "Directions in the space of the parameters:": words.gain_lines(result.gains),
        "Moved by more than chance:": moved_lines(result),
    }
    for title, lines in blocks.items():
        if lines:
            out.print(title)
        for line in lines:
            out.print(f"  {line}")
    walls = (*words.wall_lines(result), *words.hold_out_lines(result), *words.closure_lines(result))
    for text in (*words.known_lines(result), *walls):
        out.print(text)
    for text in result.unobserved:
        out.print(f"not told by these captures: {text}")
    for text in result.notes:
        out.print(f"note: {text}")
    first = words.headline(result)
    out.print(f"{first.headline}.", style=_STYLE[first.kind])
    out.print(first.explanation)


def moved_lines(result: Recalibration) -> list[str]:
    """Parameters that moved further than chance moves them, and by how many sigmas."""
    moved = [one for one in words.by_sigmas(result.moved) if abs(one.sigmas) > _UNUSUAL]
    return [
        f"{one.name}: {one.scale * one.before:.7g} → {one.scale * one.after:.7g}{f' {one.unit}' if one.unit else ''}, "
        f"{one.sigmas:+.1f} sigmas"
        for one in moved
    ]


def recalibration_json(result: Recalibration) -> dict[str, Any]:
    """The same content as JSON."""
    adjusted, table = result.adjusted, result.table
    walls = [(panorama.sweep, *words.flatness_mm(panorama)) for panorama in result.panoramas]
    return finite(
        {
            "updated": result.updated,
            "verdict": words.headline(result)._asdict(),
            "drift": asdict(result.drift),
            "lengths": [asdict(one) for one in result.lengths],
            "known_lengths": [asdict(one) for one in result.known],
            "gains": [asdict(gain) | {"factor": gain.factor} for gain in result.gains],
            "unobserved": result.unobserved,
            "moved": [asdict(one) for one in words.by_sigmas(result.moved)],
            "walls": [{"sweep": name, "before_mm": before, "after_mm": after} for name, before, after in walls],
            "hold_out": None if result.hold_out is None else asdict(result.hold_out),
            "closure": None if result.closure is None else asdict(result.closure),
            "table": {"factor": table.factor, "jumps": table.jumps, "sentences": table.sentences},
            "stations": [
                {"pose": pose, "covariance": covariance}
                for pose, covariance in zip(adjusted.stations, adjusted.station_covariance, strict=True)
            ],
            "points": int(np.count_nonzero(adjusted.point_kept)),
            "surfaces": len(adjusted.surfaces.kind),
            "wall_m": adjusted.wall_m,
            "inflation": adjusted.inflation,
            "notes": result.notes,
        }
    )
