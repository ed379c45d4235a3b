"""Where jaxscan is worse than the plain method, named and not hidden."""

from typing import Any

from experiments.real_sets.sets import SETS


SAME = 1.02
"""Figures that differ by less are the same."""
MORE, LESS = +1, -1
BOARDS = (("views", MORE), ("held_out_px", LESS), ("corner_rms_px", LESS))
LINES = (("lines", MORE), ("points", MORE), ("spread_mm", LESS), ("held_out_mm", LESS), ("halves_deg", LESS))
SWEEP = (("scene", MORE), ("on_table", MORE), ("spread_mm", LESS), ("rms_mm", LESS), ("tilt_deg", LESS))


def worse(results: dict[str, Any]) -> str:
    """A list of all figures in which the code as it is now is worse."""
    found: list[str] = []
    compared = 0
    for one in SETS:
        now, plain = results.get(one.name, {}).get("after"), results.get(one.name, {}).get("plain")
        if now is None or plain is None:
            continue
        pairs = [(f"{one.name}, boards", BOARDS, now, plain)]
        if one.header["kind"] == "sweep":
            rigs = (("plain rig", "with_plain_rig"), ("own rig", "with_own_rig"))
            pairs = [(f"{one.name}, {name}", SWEEP, now[key], plain) for name, key in rigs if key in now]
        elif plain.get("sheets"):
            sheet = (now.get("sheets") or [{}])[0]
            pairs.append((f"{one.name}, lines on boards", LINES, sheet, plain["sheets"][0]))
        for name, wanted, ours, theirs in pairs:
            known = [(key, sense) for key, sense in wanted if theirs.get(key) is not None]
            compared += len(known)
            found += [
                f"- {name}: {key} {_text(ours.get(key))}, plain {_text(theirs[key])}"
                for key, sense in known
                if _is_worse(ours.get(key), theirs[key], sense)
            ]
    return "\n".join([f"{len(found)} of {compared} figures are worse, by more than 2 %:", "", *found])


def _is_worse(ours: float | None, theirs: float, sense: int) -> bool:
    if ours is None:
        return True
    return ours * SAME < theirs if sense == MORE else ours > theirs * SAME


def _text(value: float | None) -> str:
    return "missing" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)
