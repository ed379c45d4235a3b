"""A calibration in sentences: verdict, uncertainty in millimetres, faults, and advice for the next captures."""

import math
from typing import Literal, NamedTuple

from jaxscan.calibration import Calibration, ModelTest
from jaxscan.calibration.verdict import Result, judge_views, noise_kind


TESTS = {
    "lens": (
        "Do the corner residuals still depend on where in the image they lie?",
        "the lens distorts in a way that its model cannot describe",
    ),
    "board": (
        "Do the corner residuals still depend on where on the board they lie?",
        "the board does not have the shape of its model",
    ),
    "table": (
        "Would every view have its board turned a little further?",
        "the table does not turn by the angles of its model",
    ),
    "axis": (
        "Would every view have its board moved any other way?",
        "the axis or a board did not stand still",
    ),
    "sheet": (
        "Do the stripe residuals still depend on where on the sheet they lie?",
        "the light sheet does not have the shape of its model",
    ),
    "halves": (
        "Do two halves of the records give the same rig?",
        "two halves of the records do not give the same rig",
    ),
}
"""The question of each test of the verdict, and its meaning when it fails."""


class Headline(NamedTuple):
    """The first sentences of a report."""

    kind: Literal["good", "bad", "open"]
    headline: str
    explanation: str


class LengthLine(NamedTuple):
    """Standard deviation that the calibration alone causes in one measured length."""

    what: str
    sigma_mm: float


class BadView(NamedTuple):
    """A record whose residuals stand out."""

    record: int
    why: str


def headline(calibration: Calibration) -> Headline:
    """Whether the calibration is accepted, and why; "open" without a verdict."""
    verdict = calibration.quality.verdict
    if calibration.quality.converged is False:
        reason = " ".join(verdict.advice) if verdict else "The solve did not converge, so its numbers have no meaning."
        return Headline("bad", "Not converged", reason)
    if verdict is None:
        return Headline(
            "open",
            "Not judged",
            "There is no verdict on whether the models suffice for these data.",
        )
    results = [verdict.result(test) for test in verdict.tests]
    if not verdict.accepted:
        failed = [test for test, result in zip(verdict.tests, results, strict=True) if result == "fails"]
        return Headline("bad", "Not accepted", f"The solve ended, but {_reason(failed, results)}. {_harm(failed)}")
    agree = f"Data and models agree in all {len(results)} tests" if results else "Data and models agree"
    left = (
        "the noise has no structure, but it is larger than the detectors promise; the standard deviations "
        "take that into account"
        if "noisy" in results
        else "the residuals look like noise"
    )
    return Headline("good", "Accepted", f"{agree}: {left}.")


def _harm(failed: list[ModelTest]) -> str:
    """The effect of the failed tests on lengths."""
    known = [
        (test.effect_sigma, test.effect_mm)
        for test in failed
        if test.effect_sigma is not None and test.effect_mm is not None
    ]
    if not known:
        return "The standard deviations below do not include this."
    sigma, change_mm = max(known)
    moved = f"a typical length by {change_mm:.2g} mm, {sigma:.1f} of its standard deviations"
    return f"To first order, terms missing in the models move {moved}; the sigmas below do not include this."


def _reason(failed: list[ModelTest], results: list[Result]) -> str:
    shaped = [TESTS[test.name][1] for test in failed if test.name in TESTS]
    if shaped:
        return "; ".join(shaped)
    if "noisy" in results:
        return "the residuals are larger than the noise that the detectors promise, but have no structure"
    return "the residuals are not the noise of the models"


def lengths(calibration: Calibration) -> list[LengthLine]:
    """Standard deviations of typical lengths, in words."""
    if calibration.quality.converged is False:
        return []
    lines, lasers = [], calibration.quality.lasers()
    for laser in lasers:
        beside = f", laser {laser.name}" if len(lasers) > 1 else ""
        for length in laser.lengths:
            turned = length.name == "half a turn"
            place = "between points half a turn apart" if turned else f"{length.name} at {metres(length.depth_m)}"
            lines.append(LengthLine(f"{metres(length.length_m)} {place}{beside}", length.sigma_mm))
    return lines


def noise_lines(calibration: Calibration) -> list[str]:
    """The RMS of the residuals of corners and stripes, compared with the noise that the detectors promise."""
    of, lines = calibration.quality, []
    corners = of.corners, of.corners_rejected, of.corner_rms_px, of.corner_rms_whitened
    points = of.stripe_points, of.stripe_points_rejected, of.stripe_rms_px, of.stripe_rms_whitened
    groups = ("Corners", "corner detector", corners), ("Stripes", "stripe fit", points)
    for title, source, (count, rejected, rms_px, ratio) in groups:
        if not count or rms_px is None or ratio is None:
            continue
        share = f", {100 * rejected / count:.1f} % rejected" if rejected else ", none rejected"
        # The residuals of a solve that did not converge are not judged.
        compared = f", {_promise(ratio, source)}" if of.converged is not False else ""
        lines.append(f"{title}: {count}{share}; RMS {rms_px:.3f} px{compared}.")
    return lines


def _promise(ratio: float, source: str) -> str:
    times = f"{ratio:.2f} times the noise that the {source} promised"
    return {
        "noisy": f"{times}: the promise is too low, or a model is too simple",
        "quiet": f"{times}: less noise than promised",
        "promised": f"as the {source} promised (ratio {ratio:.2f})",
    }[noise_kind(ratio)]


def second_look(calibration: Calibration) -> list[str]:
    """The gains of the second look."""
    look = calibration.quality.redetected
    if look is None:
        return []
    if not look.kept:
        return ["The second look at the images explained them no better than the first, and was dropped."]
    counts = {"views": look.views_gained, "corners": look.corners_gained, "stripe points": look.stripe_points_gained}
    gains = ", ".join(f"{gained:+d} {name}" for name, gained in counts.items() if gained)
    return [f"The second look at the images: {gains or 'nothing more'}."]


def warnings(calibration: Calibration) -> list[str]:
    """Warnings of the solve, without those on records that `bad_views` names."""
    named = tuple(f"record {view.record}{after}" for view in bad_views(calibration) for after in " :")
    return [text for text in calibration.quality.warnings if not text.startswith(named)]


def advice(calibration: Calibration) -> tuple[str, ...]:
    """Captures or changes that would improve the calibration."""
    quality = calibration.quality
    # If the solve did not converge, `headline` shows the advice.
    return () if quality.verdict is None or quality.converged is False else quality.verdict.advice


def bad_views(calibration: Calibration) -> list[BadView]:
    """Records whose corners fit much worse than the corners of other records, worst first."""
    if calibration.quality.converged is False:
        return []
    found = []
    for view in judge_views(calibration.quality, calibration.fit, calibration.observations):
        of, why = view.quality, []
        if of.dropped:
            why.append(f"left out, its corners are {of.corner_rms_px or 0.0:.2f} px off")
        elif view.lost_many:
            why.append(f"{of.corners_rejected} of {of.corners} corners rejected")
        if view.far_off:
            why.append(f"{view.rms_px:.2f} px where {view.usual_px:.2f} px are usual")
        if why:
            found.append(BadView(of.record, ", ".join(why)))
    return found


def metres(value: float) -> str:
    """A length as text: 300 mm, 3.82 m."""
    return f"{1e3 * value:.0f} mm" if value < 0.9995 else f"{value:.3g} m"


def millimetres(sigma_mm: float) -> str:
    """A standard deviation with two significant digits."""
    if sigma_mm <= 0:
        return "0 mm"
    decimals = max(0, 1 - math.floor(math.log10(sigma_mm)))
    return f"{sigma_mm:.{min(decimals, 6)}f} mm"
