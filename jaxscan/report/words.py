"""A calibration in sentences: verdict, uncertainty in millimetres, faults, and advice for the next captures."""

import datetime
import math
from pathlib import Path
from typing import Literal, NamedTuple

from jaxscan.calibration import Calibration, GoodTo, ModelTest, Quality, is_named, judge_views, noise_kind
from jaxscan.geometry import MOTIONS, Hand


TESTS = {
    "lens": (
        "Do the corner residuals still depend on where in the image they lie?",
        "the lens model falls short",
    ),
    "board": (
        "Do the corner residuals still depend on where on the board they lie?",
        "the board is not flat",
    ),
    "paper": (
        "Would every placement have its board bent another way?",
        "the board bends from view to view",
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
        "two halves of the records disagree",
    ),
    "regions": (
        "Does the middle of the image alone give the same lens?",
        "the lens model goes astray where no corner was seen",
    ),
    "lines": (
        "Does the sheet stay where it is if the lines count that were left out?",
        "the lines on some boards, left out, lie on another sheet: boards or laser moved between pictures",
    ),
}
"""The question of each test of the verdict, and the cause of harm when it finds structure."""


_PARTS = {
    "angles": "the angles of the table",
    "axis": "where the axis is",
    "sheet": "the laser's sheet",
    "camera": "camera and lens",
}
_BETTER = {
    "angles": "boards that stand still while the table turns all around (0, 90, 180 and 270 degrees), or a sweep of a "
    "room (`jaxscan recalibrate`)",
    "axis": "boards that stand still while the table turns farther, or a sweep of a room (`jaxscan recalibrate`)",
    "sheet": "the laser's line on boards at clearly different distances",
    "camera": "more boards, tilted by 20 to 45 degrees and right into the corners of the image",
}
_BETTER_BY_SWEEPS = dict.fromkeys(("angles", "axis"), "more sweeps") | dict.fromkeys(
    ("sheet", "camera"), "a length in the room that is known (`--known`), or more boards"
)
"""The same advice for a calibration that sweeps have already refined."""
# The squares of smaller parts add less than a thousandth.
_LEAST_PART = 0.03

OF_LENGTHS = (
    "Standard deviations of lengths measured with this rig, as far as the calibration causes them. The noise of the "
    "stripes adds to them."
)

# Two significant digits of more pixels would need an exponent.
_WHOLE_PX = 99.5
# Shorter ones are no walls.
_WALL_M = 1.0

# Records that are named in one line.
_NAMED = 12


class Headline(NamedTuple):
    """The first sentences of a report."""

    kind: Literal["good", "plain", "bad", "open"]
    """"good": within the user's limit; "plain": usable, without a limit; "bad": refused; "open": not judged."""
    headline: str
    explanation: str


class LengthLine(NamedTuple):
    """Standard deviation that the calibration alone causes in one measured length."""

    what: str
    sigma_mm: float
    part: bool = False
    """Whether it is a part of the line before, which its parts make up."""


class BadView(NamedTuple):
    """A record whose residuals stand out."""

    record: int
    why: str


def headline(calibration: Calibration) -> Headline:
    """The error of the calibration and its causes; "open" without a verdict."""
    verdict = calibration.quality.verdict
    if calibration.quality.converged is False:
        reason = verdict.refused if verdict else None
        return Headline("bad", "Not converged", reason or "The solve did not converge, so its numbers have no meaning.")
    if verdict is None:
        return Headline("open", "Not judged", "There is no verdict on the error of this calibration.")
    good_to = verdict.good_to
    if verdict.usable is None or good_to is None:
        reason = "The verdict of this file does not say how large the error is: calibrate again."
        return Headline("open", "Not judged", reason)
    size, parts = f"{good_to_words(good_to)}{_by_poses(calibration, good_to)}", _parts(calibration.quality, good_to)
    if verdict.usable is False:
        because = f"; {parts}" if parts else ""
        return Headline("bad", f"Good to only {size}", f"Refused: {verdict.refused or 'it cannot be used'}{because}.")
    kind: Literal["good", "plain"] = "good" if _limited(calibration) else "plain"
    return Headline(kind, f"Good to {size}{f'; {parts}' if parts else ''}", _explanation(calibration, good_to))


def _limited(calibration: Calibration) -> bool:
    """Whether a limit was set that the calibration keeps; the file is not trusted."""
    settings = calibration.provenance.get("settings")
    return isinstance(settings, dict) and any(settings.get(key) is not None for key in ("limit_mm", "limit_px"))


def good_to_words(good_to: GoodTo) -> str:
    """Millimetres of a length for a rig, pixels for a camera alone."""
    if good_to.sigma_mm is not None and good_to.at_m is not None:
        if good_to.length_m is None:
            return f"{millimetres(good_to.sigma_mm)} at {metres(good_to.at_m)}"
        article = "a " if good_to.length_m >= _WALL_M else ""
        return f"{millimetres(good_to.sigma_mm)} for {article}{length_words('wall', good_to.length_m, good_to.at_m)}"
    return (
        "an unknown size" if good_to.sigma_px is None else f"{pixels(good_to.sigma_px)} over the image{_edge(good_to)}"
    )


def _by_poses(calibration: Calibration, good_to: GoodTo) -> str:
    """The error of a profile's place by the given pose of the hand, which is no part of the calibration; or ""."""
    hand, reach = _hand(calibration), good_to.at_m or 1.0
    if hand is None:
        return ""
    place, angle = (float(one) for one in hand.scatter)
    away = millimetres(1e3 * math.hypot(place, angle * reach))
    return f" within one profile, and each pose of the hand adds {away} at {metres(reach)}"


def _hand(calibration: Calibration) -> Hand | None:
    motion = None if calibration.scanner is None else calibration.scanner.turntable
    return motion if isinstance(motion, Hand) else None


def _edge(good_to: GoodTo) -> str:
    """Where rays were not judged; "" where all of the image was."""
    edge = good_to.edge_deg
    return "" if edge is None else f" (beyond {edge:.0f} degrees from the optical axis nothing is judged)"


def _parts(quality: Quality, good_to: GoodTo) -> str:
    """The causes that are large enough to be named, the largest first; a board that bends always is."""
    rig = good_to.sigma_mm is not None
    whole = (good_to.sigma_mm if rig else good_to.sigma_px) or 0.0
    tests = quality.verdict.tests if quality.verdict else ()
    sizes = [((test.effect_mm if rig else test.effect_px) or 0.0, test) for test in tests]
    worth = [(size, test) for size, test in sizes if is_named(size, whole) or test.bend_mm]
    named = sorted(worth, key=lambda part: -part[0])
    texts = [
        f"{millimetres(size) if rig else pixels(size)}{'' if index else ' of that'} because {_cause(test, quality)}"
        for index, (size, test) in enumerate(named)
    ]
    return ", and ".join(texts) if len(texts) < 3 else f"{', '.join(texts[:-1])}, and {texts[-1]}"


def _cause(test: ModelTest, quality: Quality) -> str:
    cause = TESTS[test.name][1] if test.name in TESTS else f"the test {test.name!r} found structure"
    if test.name == "board":
        freed = quality.board is not None and quality.board.free != "parabola"
        cause = (
            "the board's shape falls short, though it was freed" if freed else f"{cause} (its shape could not be found)"
        )
    if test.bend_mm:
        cause = f"{cause} by {millimetres(test.bend_mm)}"
    return f"{cause} {test.where}" if test.where else cause


def _explanation(calibration: Calibration, good_to: GoodTo) -> str:
    quality = calibration.quality
    verdict, board, held = quality.verdict, quality.board, _held(calibration)
    results = [verdict.result(test) for test in verdict.tests] if verdict else []
    # A recalibration from sweeps has no tests of boards.
    sentences = ["The residuals look like noise."] if "recalibration" not in calibration.provenance else []
    if "structure" in results:
        rig = good_to.sigma_mm is not None
        alone = millimetres(good_to.statistical_mm or 0.0) if rig else pixels(good_to.statistical_px or 0.0)
        sentences = [f"All sigmas include this; noise alone would give {alone}."]
    elif "noisy" in results:
        sentences = ["The noise has no structure but is larger than the detectors promise; the sigmas include that."]
    if halved := _halved(calibration, good_to):
        sentences.append(halved)
    if good_to.sigma_mm is not None and good_to.sigma_px is not None:
        sentences.append(f"Its rays are good to {pixels(good_to.sigma_px)}{_edge(good_to)}.")
    if (hand := _hand(calibration)) is not None:
        place, angle = (float(one) for one in hand.scatter)
        sentences.append(
            f"Each pose of the hand is off by {millimetres(1e3 * place)} and {math.degrees(angle):.2g} degrees."
        )
    if board is not None and board.free != "parabola":
        sentences.append(f"The board's shape was freed: {millimetres(1e3 * board.rms_off_flat_m)} RMS off flat.")
    if held:
        sentences.append(f"The {' and '.join(held)} that was given counts as exact: no sigma includes its error.")
    return " ".join(sentences)


def _halved(calibration: Calibration, good_to: GoodTo) -> str:
    """The largest part of the error, and what would halve it; "" where the parts are not known."""
    verdict, whole = calibration.quality.verdict, good_to.sigma_mm
    if not good_to.parts or not whole or verdict is None:
        return ""
    largest = max(good_to.parts, key=lambda part: part.sigma_mm)
    test = max(verdict.tests, key=lambda test: test.effect_mm or 0.0, default=None)
    size, cure = largest.sigma_mm, _BETTER[largest.name]
    if "recalibration" in calibration.provenance:
        cure = _BETTER_BY_SWEEPS[largest.name]
    said = f"Its largest part, {millimetres(size)}, comes from {_part(largest.name, calibration)}"
    if test is not None and (test.effect_mm or 0.0) > size:
        # The headline has named it.
        size, cure = test.effect_mm or 0.0, verdict.advice[0] if verdict.advice else ""
        said = "That is its largest part"
    if not cure:
        return f"{said}."
    halves = math.sqrt(max(0.0, whole**2 - size**2)) <= whole / 2
    return (
        f"{said}; {'what would halve it' if halves else 'no part alone would halve it, and the first step is'}: {cure}."
    )


def _part(name: str, calibration: Calibration) -> str:
    part = "axis" if calibration.scanner is None else MOTIONS[calibration.scanner.turntable.carries].part
    return f"the {part}" if name == "axis" != part else _PARTS[name]


def _held(calibration: Calibration) -> list[str]:
    """The parts that were given and held; the file is not trusted."""
    said = calibration.provenance.get("held")
    return [part for part in ("camera", "sheet", "axis") if isinstance(said, list) and part in said]


def lengths(calibration: Calibration) -> list[LengthLine]:
    """Standard deviations of typical lengths, in words; that of the verdict with its parts, which make it up."""
    if calibration.quality.converged is False:
        return []
    lines, lasers, parts = [], calibration.quality.lasers(), _part_lines(calibration)
    worst = max((one.sigma_mm for laser in lasers for one in laser.lengths if one.name == "wall"), default=None)
    for laser in lasers:
        beside = f", laser {laser.name}" if len(lasers) > 1 else ""
        for length in laser.lengths:
            words = length_words(length.name, length.length_m, length.depth_m)
            lines.append(LengthLine(f"{words}{beside}", length.sigma_mm))
            if length.name == "wall" and length.sigma_mm == worst:
                lines += parts
    return lines


def length_words(name: str, length_m: float, depth_m: float) -> str:
    """A typical length in words: 4 m wall from 2.5 m."""
    if name == "wall":
        return f"{metres(length_m)} {'wall from' if length_m >= _WALL_M else 'at'} {metres(depth_m)}"
    place = "between points half a turn apart" if name == "half a turn" else f"{name} at {metres(depth_m)}"
    return f"{metres(length_m)} {place}"


def _part_lines(calibration: Calibration) -> list[LengthLine]:
    """What makes up the error of the verdict, the largest first; the squares add up."""
    verdict = calibration.quality.verdict
    good_to = None if verdict is None else verdict.good_to
    if verdict is None or good_to is None or not good_to.parts or not good_to.sigma_mm:
        return []
    found = [LengthLine(f"of that from {_part(part.name, calibration)}", part.sigma_mm, True) for part in good_to.parts]
    found += [
        LengthLine(f"of that because {_cause(test, calibration.quality)}", test.effect_mm, True)
        for test in verdict.tests
        if test.effect_mm
    ]
    kept = [line for line in found if line.sigma_mm > _LEAST_PART * good_to.sigma_mm]
    return sorted(kept, key=lambda line: -line.sigma_mm)


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
        lines.append(f"{title}: {count:,}{share}; RMS {rms_px:.3f} px{compared}.")
    return lines


def _promise(ratio: float, source: str) -> str:
    times = f"{ratio:.2f} times the noise that the {source} promised"
    return {
        "noisy": f"{times}: the promise is too low, or a model is too simple",
        "quiet": f"{times}: less noise than promised",
        "promised": f"as the {source} promised (ratio {ratio:.2f})",
    }[noise_kind(ratio)]


def board_lines(calibration: Calibration) -> list[str]:
    """How many records show the board, and the likely reasons why the others do not."""
    of = calibration.quality
    if not of.records:
        return []
    reasons: dict[str, list[int]] = {}
    for missed in of.missed:
        reasons.setdefault(missed.why, []).append(missed.record)
    lines = [f"Board found in {of.records - len(of.missed)} of {of.records} records."]
    for why, records in sorted(reasons.items(), key=lambda item: -len(item[1])):
        more = f" and {len(records) - _NAMED} more" if len(records) > _NAMED else ""
        several = "records" if len(records) > 1 else "record"
        lines.append(f"Not found in {several} {', '.join(map(str, records[:_NAMED]))}{more}: {why}.")
    return lines


def second_look(calibration: Calibration) -> list[str]:
    """The gains of the second look."""
    look = calibration.quality.redetected
    if look is None:
        return []
    if not look.kept:
        return ["The second look at the images explained them no better than the first, and was not kept."]
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
    # 0.00997 is rounded like 0.01.
    decimals = max(0, 1 - math.floor(math.log10(float(f"{sigma_mm:.1e}"))))
    return f"{sigma_mm:.{min(decimals, 6)}f} mm"


def pixels(sigma_px: float) -> str:
    """The same in pixels."""
    return f"{sigma_px:.2g} px" if sigma_px < _WHOLE_PX else f"{sigma_px:.0f} px"


def calibration_date(calibration: Calibration, path: Path | None = None) -> str:
    """The day and minute (UTC) of a calibration, or of its file where the calibration does not say; "" if unknown."""
    said = calibration.provenance.get("date")
    if isinstance(said, str):
        try:
            return _shown(datetime.datetime.fromisoformat(said))
        except (ValueError, OverflowError):
            # A file may say anything.
            return ""
    if path is None or not path.is_file():
        return ""
    written = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.UTC)
    return f"{_shown(written)}, by the time of its file"


def capture_names(calibration: Calibration) -> list[str]:
    """Names of the captures that a calibration was made from; the file is not trusted."""
    found = calibration.provenance.get("captures")
    return [str(one.get("name")) for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _shown(when: datetime.datetime) -> str:
    zone = when.astimezone(datetime.UTC) if when.tzinfo else when
    return f"{zone.day} {zone:%B %Y, %H:%M} UTC"


def sentence(text: str) -> str:
    """Text as a sentence: with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}."
