"""A calibration in words: is it good, how good in millimetres, what is wrong, what to do next.

A file may come from anywhere, so what it says of its quality is taken only where it is of the
expected kind; what is missing is left out.
"""

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.verdict.judge import ACCEPTED_P


TESTS = {
    "lens": (
        "Do the corner residuals still depend on where in the image they lie?",
        "the lens bends light in a way that its model does not have",
    ),
    "board": (
        "Do the corner residuals still depend on where on the board they lie?",
        "the board is not of the shape that it is taken for",
    ),
    "table": (
        "Would every view have its board turned a little further?",
        "the table does not turn by the angles of its model",
    ),
    "axis": (
        "Would every view have its board moved any other way?",
        "the axis does not stand still, or a board did not",
    ),
    "sheet": (
        "Do the stripe residuals still depend on where on the sheet they lie?",
        "the light sheet is not of the shape of its model",
    ),
    "halves": (
        "Do two halves of the records give the same rig?",
        "two halves of the records do not give the same rig",
    ),
}
"""What each test of the verdict asks, and what it means when it fails."""

# Whitened residuals this far from 1 are worth a word.
_QUIET, _NOISY = 0.75, 1.33
# A view whose kept residuals are this many times the usual ones is named, and so is one with this share rejected.
_BAD_RATIO, _BAD_SHARE = 2.0, 0.2


class Verdict(NamedTuple):
    """The first thing that a report says."""

    kind: Literal["good", "bad", "open"]
    headline: str
    explanation: str


class LengthLine(NamedTuple):
    """What the calibration alone makes uncertain in one measured length."""

    what: str
    sigma_mm: float


class BadView(NamedTuple):
    """A record whose residuals stand out."""

    record: int
    why: str


def verdict(calibration: Calibration) -> Verdict:
    """Accepted or not, and why; "open" where nobody has judged."""
    judged = calibration.quality.get("verdict")
    if not isinstance(judged, dict) or not isinstance(judged.get("accepted"), bool):
        return Verdict("open", "Not judged", "Nothing says whether the models of the rig suffice for these data.")
    tests = outcomes(calibration)
    if judged["accepted"]:
        agree = f"Data and models agree in all {len(tests)} tests" if tests else "Data and models agree"
        noisy = any(test.result == "noisy" for test in tests)
        left = (
            "what is left in the residuals has no structure, although there is more of it than the detectors promise; "
            "the standard deviations take that into account"
            if noisy
            else "what is left in the residuals looks like noise"
        )
        return Verdict("good", "Accepted", f"{agree}: {left}.")
    return Verdict(
        "bad",
        "Not accepted",
        f"The solve ended, but {_reason(tests)}. {_harm(tests)}",
    )


def _harm(tests: list["Outcome"]) -> str:
    """What the failed tests mean for lengths."""
    failed = [test for test in tests if test.result == "fails"]
    known = [test for test in failed if test.effect_mm is not None and test.effect_sigma is not None]
    if not known:
        return "The standard deviations below do not cover this."
    worst = max(known, key=lambda test: test.effect_sigma or 0.0)
    moved = f"a typical length by {worst.effect_mm:.2g} mm, {worst.effect_sigma:.1f} of its standard deviations"
    return f"To first order, terms that the models lack would move {moved}; those below do not cover this."


def _reason(tests: list["Outcome"]) -> str:
    shaped = [TESTS[test.name][1] for test in tests if test.result == "fails" and test.name in TESTS]
    if shaped:
        return "; ".join(shaped)
    if any(test.result == "noisy" for test in tests):
        return "the residuals are larger than the noise that the detectors promise, although without structure"
    return "the residuals are not the noise that they are taken for"


class Outcome(NamedTuple):
    """One test of the verdict."""

    name: str
    statistic: float | None
    dof: float | None
    p: float | None
    """Chance of a larger statistic, with the noise that the detectors promise."""
    p_structure: float | None
    """The same with the noise that was estimated, so that structure alone counts."""
    effect_mm: float | None
    """How far the typical length that suffers most would go if the model had what it lacks."""
    effect_sigma: float | None
    """The same over the standard deviation that the calibration causes in that length."""
    result: Literal["passes", "noisy", "fails"]
    """It "fails" where there is structure in the residuals; they are "noisy" where only larger than was promised."""


def outcomes(calibration: Calibration) -> list[Outcome]:
    """The tests of the verdict, where there is one."""
    judged = calibration.quality.get("verdict")
    tests = [test for test in records(judged, "tests") if isinstance(test.get("name"), str)]
    # One in a hundred in all of them together, by chance.
    limit = ACCEPTED_P / max(len(tests), 1)

    def result(p: float | None, p_structure: float | None) -> Literal["passes", "noisy", "fails"]:
        structure = p if p_structure is None else p_structure
        if structure is not None and structure <= limit:
            return "fails"
        return "noisy" if p is not None and p <= limit else "passes"

    found = []
    for test in tests:
        keys = ("statistic", "dof", "p", "p_structure", "effect_mm", "effect_sigma")
        statistic, dof, p, structure, effect_mm, effect_sigma = (number(test, key) for key in keys)
        name = test["name"]
        found.append(Outcome(name, statistic, dof, p, structure, effect_mm, effect_sigma, result(p, structure)))
    return found


def lengths(calibration: Calibration) -> list[LengthLine]:
    """Standard deviations of typical lengths, in words."""
    lines = []
    found = lasers_of(calibration)
    for name, laser in found:
        beside = f", laser {name}" if len(found) > 1 else ""
        for length in records(laser, "lengths"):
            value, depth, sigma = (number(length, key) for key in ("length_m", "depth_m", "sigma_mm"))
            kind = length.get("name")
            if value is None or depth is None or sigma is None or not isinstance(kind, str):
                continue
            if kind == "half a turn":
                what = f"{metres(value)} between points half a turn apart{beside}"
            else:
                what = f"{metres(value)} {kind} at {metres(depth)}{beside}"
            lines.append(LengthLine(what, sigma))
    return lines


def lasers_of(calibration: Calibration) -> list[tuple[str, dict[str, Any]]]:
    """Name and predicted uncertainties of every laser."""
    predicted = calibration.quality.get("lengths")
    return [
        (str(laser.get("name", "laser")), laser)
        for laser in (records(predicted, "lasers") if isinstance(predicted, dict) else [])
    ]


def noise_lines(calibration: Calibration) -> list[str]:
    """How large the residuals of each group are, and whether that is what was promised."""
    quality, lines = calibration.quality, []
    counts = {"corner": ("corners", "Corners", "corner detector"), "stripe": ("stripe_points", "Stripes", "stripe fit")}
    for group, (key, title, source) in counts.items():
        count, rejected = number(quality, key), number(quality, f"{key}_rejected")
        rms, whitened = number(quality, f"{group}_rms_px"), number(quality, f"{group}_rms_whitened")
        if not count or rms is None or whitened is None:
            continue
        if whitened > _NOISY:
            words = f"{whitened:.2f} times what the {source} promised: it promises too much, or a model is too simple"
        elif whitened < _QUIET:
            words = f"{whitened:.2f} times what the {source} promised: quieter than it says"
        else:
            words = f"as the {source} promised (ratio {whitened:.2f})"
        share = f", {100 * rejected / count:.1f} % rejected" if rejected else ", none rejected"
        lines.append(f"{title}: {count:.0f}{share}; RMS {rms:.3f} px, {words}.")
    return lines


def second_look(calibration: Calibration) -> list[str]:
    """What looking at the images again, with the geometry known, has brought."""
    brought = calibration.quality.get("redetected")
    if not isinstance(brought, dict) or not isinstance(brought.get("kept"), bool):
        return []
    if not brought["kept"]:
        return ["A second look at the images explained them worse than the first, and was not kept."]
    gains = []
    for key, name in (("views", "views"), ("corners", "corners"), ("stripe_points", "stripe points")):
        gained = number(brought, f"{key}_gained")
        if gained:
            gains.append(f"{gained:+.0f} {name}")
    return [f"A second look at the images, with the geometry known: {', '.join(gains) or 'nothing more'}."]


def warnings(calibration: Calibration) -> list[str]:
    """What the solve itself warns of, but for records that `bad_views` names."""
    named = tuple(f"record {view.record}{after}" for view in bad_views(calibration) for after in " :")
    return [text for text in _strings(calibration.quality.get("warnings")) if not text.startswith(named)]


def advice(calibration: Calibration) -> list[str]:
    """What to capture or to change next."""
    judged = calibration.quality.get("verdict")
    return _strings(judged.get("advice")) if isinstance(judged, dict) else []


def views(calibration: Calibration) -> list[dict[str, Any]]:
    """`quality["per_view"]`, the worst first; where the fit is known, with the row `view` of the observations and
    `kept_rms_px` of the corners that were not rejected."""
    found = [view for view in records(calibration.quality, "per_view") if number(view, "record") is not None]
    fit, observations = calibration.fit, calibration.observations
    if fit is not None and observations is not None:
        square = np.where(fit.corner_kept, np.sum(fit.corner_error**2, -1), 0.0).sum(1)
        count = fit.corner_kept.sum(1)
        rms = np.sqrt(square / np.maximum(count, 1))
        # Several captures may have records of the same number; all of them stand in the order of the views.
        rows = iter(enumerate(np.asarray(observations.corners.record).tolist()))
        for place, view in enumerate(found):
            row = next((row for row, record in rows if record == view["record"]), None)
            if row is not None:
                kept = {"kept_rms_px": float(rms[row])} if count[row] else {}
                found[place] = view | {"view": row} | kept

    def size(view: dict[str, Any]) -> float:
        # Of a view that was left out as a whole nothing is kept.
        return number(view, "kept_rms_px") or number(view, "corner_rms_px") or 0.0

    return sorted(found, key=lambda view: -size(view))


def bad_views(calibration: Calibration) -> list[BadView]:
    """Records whose corners fit much worse than the others', worst first."""
    every = views(calibration)
    dropped = calibration.quality.get("views_dropped")
    sizes = [size for view in every if (size := number(view, "kept_rms_px"))]
    usual = float(np.median(sizes)) if sizes else 0.0
    found = []
    for view in every:
        rms, kept, seen, gone = (
            number(view, key) or 0.0 for key in ("corner_rms_px", "kept_rms_px", "corners", "corners_rejected")
        )
        why = []
        if isinstance(dropped, list | tuple) and view["record"] in dropped:
            why.append(f"left out, its corners are {rms:.2f} px off")
        elif gone > _BAD_SHARE * seen:
            why.append(f"{gone:.0f} of {seen:.0f} corners rejected")
        if kept > _BAD_RATIO * usual > 0:
            why.append(f"{kept:.2f} px where {usual:.2f} px are usual")
        if why:
            found.append(BadView(int(view["record"]), ", ".join(why)))
    return found


def metres(value: float) -> str:
    """A length as people say it: 300 mm, 3.82 m."""
    return f"{1e3 * value:.0f} mm" if value < 0.9995 else f"{value:.3g} m"


def millimetres(sigma_mm: float) -> str:
    """A standard deviation with two digits that mean something."""
    if sigma_mm <= 0:
        return "0 mm"
    decimals = max(0, 1 - math.floor(math.log10(sigma_mm)))
    return f"{sigma_mm:.{min(decimals, 6)}f} mm"


def number(table: object, key: str) -> float | None:
    """A finite number of a table; None where it is something else."""
    value = table.get(key) if isinstance(table, dict) else None
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        return None
    return float(value)


def records(table: object, key: str) -> list[dict[str, Any]]:
    """A list of tables inside a table; empty where it is something else."""
    value = table.get(key) if isinstance(table, dict) else None
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list | tuple) else []


def _strings(value: object) -> list[str]:
    return [item for item in value if isinstance(item, str)] if isinstance(value, list | tuple) else []
