"""Stripes of an earlier reconstruction: the settings they depend on, and whether another calibration may use them."""

import dataclasses
from typing import Any

import numpy as np

from jaxscan.reconstruction.along import SmoothedSweep
from jaxscan.reconstruction.extraction import Extraction, empty_stripes
from jaxscan.reconstruction.plan import Plan
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.stripes import LineGate, NoiseModel, Stripes


_SMOOTHED = "smoothed_"


def extraction_key(settings: ReconstructSettings, noise: NoiseModel | None) -> dict[str, Any]:
    """The settings that the stripes of a sweep depend on, as JSON holds them."""
    return {
        "stripes": dataclasses.asdict(settings.stripes),
        "noise": None if noise is None else dataclasses.asdict(noise),
        # Another range might choose other stripes among those that were searched.
        "range_m": [str(settings.min_range_m), str(settings.max_range_m)],
        "gate": settings.gate,
        "check_steps": settings.check_steps,
    }


def kept_arrays(found: Extraction, plan: Plan) -> dict[str, np.ndarray]:
    """The stripes, smoothed too where they are; notes on them and, of each laser, the searched part of lines and the
    near side."""
    fields = {name: np.asarray(field) for name, field in vars(found.stripes).items() if field is not None}
    if found.smoothed is not None:
        fields |= {_SMOOTHED + name: field for name, field in found.smoothed._asdict().items()}
    texts = {"notes": "\n".join(found.notes), "noise": found.noise}
    return fields | _searched(plan.gates) | {name: np.frombuffer(t.encode(), np.uint8) for name, t in texts.items()}


def usable_stripes(arrays: dict[str, np.ndarray], plan: Plan) -> Extraction | None:
    """The kept stripes, if a search by this plan could find no others; else None.

    The search reaches `GATE_MARGIN_PX` beyond the range limits. As long as the limits as the plan's calibration
    sees them lie within the searched part of every line, nothing can have been missed.
    """
    fields, gated = dict(arrays), plan.settings.gate or plan.lit_together
    for name, wanted in _searched(plan.gates_beyond(0.0)).items():
        searched = fields.pop(name, None)
        if searched is None or searched.shape != wanted.shape:
            return None
        if name.startswith("near_side"):
            if np.any(searched != wanted):
                return None
        elif gated:
            empty = wanted[0] >= wanted[1]
            if not np.all(empty | ((searched[0] <= wanted[0]) & (wanted[1] <= searched[1]))):
                return None
    texts = [fields.pop(name, np.zeros(0)) for name in ("notes", "noise")]
    smoothed = {name: fields.pop(_SMOOTHED + name) for name in SmoothedSweep._fields if _SMOOTHED + name in fields}
    if any(text.dtype != np.uint8 for text in texts) or not _fit(fields, plan):
        return None
    grid = fields["u"]
    if smoothed and not all(name in smoothed for name in SmoothedSweep._fields):
        return None
    if any(field.dtype != np.float32 or field.shape != grid.shape for field in smoothed.values()):
        return None
    notes, noise = (text.tobytes().decode(errors="replace") for text in texts)
    return Extraction(
        Stripes(**fields), tuple(notes.splitlines()), noise, SmoothedSweep(**smoothed) if smoothed else None
    )


def _fit(fields: dict[str, np.ndarray], plan: Plan) -> bool:
    """Whether arrays are the stripes of a plan by their names, types and shapes."""
    grid = len(np.atleast_1d(fields.get("record", ()))), plan.lines
    expected = empty_stripes(0, plan.lines) | {"record": plan.sweep.record, "laser": plan.sweep.laser}
    shapes = {"record": grid[:1], "laser": grid[:1], "rgb": (*grid, 3)}
    whole = grid[0] > 0 and grid[0] % len(plan.sweep.record) == 0
    return (
        whole
        and fields.keys() == expected.keys()
        and all(array.shape == shapes.get(name, grid) for name, array in fields.items())
        and all(array.dtype == expected[name].dtype for name, array in fields.items())
    )


def _searched(gates: dict[int, LineGate]) -> dict[str, np.ndarray]:
    searched = {}
    for laser, gate in gates.items():
        searched[f"searched_{laser}"] = np.stack([gate.low, gate.high])
        searched[f"near_side_{laser}"] = np.array(gate.near_side)
    return searched
