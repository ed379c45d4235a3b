"""A case: a number becomes a folder with files, some of them changed, and the words of a command."""

import random
from collections.abc import Callable
from pathlib import Path

from .archives import change_npz
from .camera_cases import camera_case
from .cloud_cases import align_targets, convert_cloud, make_product, measure_cloud, stranger_cloud
from .draft import IN, OUT, VICTIM, Case, Draft, changed_capture
from .nasty import nasty_number
from .pictures import change_image
from .places import replace_place, strange_name
from .project_cases import (
    hard_disk,
    many_lines,
    paper_case,
    project_case,
    recalibrate_case,
    served_case,
    video_case,
    wrong_angles,
)
from .talk_cases import orders_case
from .texts import change_bytes, change_json, change_toml


def make_case(seed: int, number: int, corpus: Path, folder: Path) -> Case:
    """Case `number` of a seed: its files in a new folder, and its command."""
    rng = random.Random(f"{seed}:{number}")
    draft = Draft(rng, corpus, folder)
    kinds, weights = zip(*KINDS.items(), strict=True)
    (make,) = rng.choices(kinds, weights)
    return make(draft)


def _reconstruct(draft: Draft) -> Case:
    name = draft.rng.choice(("unsealed", "sealed", "shards"))
    capture, calibration = changed_capture(draft, name), draft.take("calibration.json")
    output = draft.output("cloud.npz")
    words = ["reconstruct", str(capture), "-c", str(calibration), "-o", output]
    if draft.rng.random() < 0.05:
        words += ["--json", draft.rng.choice((output, str(calibration), str(capture / "frames.jsonl"), "-"))]
    return Case(f"reconstruct {name}", words, {f"{OUT}/cloud.npz"}, {f"{IN}/{name}/stripes.npz"}, f"{OUT}/cloud.npz")


def _reconstruct_with(draft: Draft) -> Case:
    capture, calibration = draft.take("unsealed"), draft.take("calibration.json")
    draft.change(calibration, change_json)
    words = ["reconstruct", str(capture), "-c", str(calibration), "-o", draft.output("cloud.ply")]
    return Case("reconstruct calibration", words, {f"{OUT}/cloud.ply"}, {f"{IN}/unsealed/stripes.npz"})


def _repack(draft: Draft) -> Case:
    name = draft.rng.choice(("unsealed", "sealed", "shards"))
    capture = changed_capture(draft, name)
    words = ["convert", str(capture), draft.output("new"), "--storage", draft.rng.choice(("npy", "png", "zstd"))]
    return Case(f"convert {name}", words, {f"{OUT}/new"})


def _import(draft: Draft) -> Case:
    """A stranger's folder: images damaged or replaced by links and pipes, strange patterns, boards and angles."""
    rng, folder = draft.rng, draft.take("unsealed")
    images = sorted(one for side in ("on", "off") for one in (folder / side).iterdir())
    for _ in range(rng.choice((0, 1, 1, 3))):
        match rng.randrange(4):
            case 0:
                draft.change(rng.choice(images), change_image)
            case 1:
                replace_place(rng, rng.choice((*images, folder / "on", folder / "off")), draft.folder / VICTIM)
                images = [one for one in images if one.is_file() and not one.is_symlink()]
            case 2:
                name = f"{rng.choice(('on', 'off', 'laser', 'x'))}{rng.randrange(10 ** rng.randrange(1, 20))}"
                suffix = rng.choice((".png", ".mp4", ".avi", ".JPG"))
                (folder / (name + suffix)).write_bytes(
                    rng.choice((b"", b"RIFF0000AVI ", b"#EXTM3U\n/dev/zero\n", rng.randbytes(99)))
                )
            case _:
                (folder / "angles.txt").write_bytes(change_bytes(rng, b"".join(b"%d.5 0\n" % k for k in range(12))))
        if not images:
            break
    patterns = ("on/*.png", "off/*", "*", "../*", "/etc/*", "[", "[!]", "*" * 300, "on/00000?.png", strange_name(rng))
    words = ["import", str(folder), "-o", draft.output("new")]
    words += rng.choice((["--step-deg", "1"], ["--step-deg", "1"], ["--angles", str(folder / "angles.txt")], []))
    for option in ("--on", "--off", "--boards"):
        if rng.random() < 0.12:
            words += [option, *(rng.choice(patterns) for _ in range(rng.choice((1, 1, 2))))]
    if rng.random() < 0.2:
        words += [
            "--board",
            rng.choice(("chessboard 9x6 25mm", "aprilgrid 6x6 24mm 7mm", "circles 4x11 1e9mm 2mm", "")),
        ]
    if rng.random() < 0.2:
        option, value = rng.choice((("--every", nasty_number(rng)), ("--response", "learn"), ("--exposures-ms", "1")))
        words += [option, str(value)]
    return Case("import", words, {f"{OUT}/new"})


def _verify(draft: Draft) -> Case:
    name = draft.rng.choice(("unsealed", "sealed", "shards"))
    return Case(f"doctor {name}", ["doctor", "--capture", str(changed_capture(draft, name))])


def _calibrate(draft: Draft) -> Case:
    capture = changed_capture(draft, "boards")
    words = ["calibrate", str(capture), "-o", draft.output("c.json")]
    if draft.rng.random() < 0.5:
        words += ["--only", "camera"]
    return Case("calibrate", words, {f"{OUT}/c.json", f"{OUT}/c.npz"})


def _changed_calibration(draft: Draft) -> str:
    calibration = draft.take("calibration.json")
    if draft.rng.random() < 0.3:
        draft.change(draft.take("calibration.npz"), change_npz)
    else:
        draft.change(calibration, change_json)
    return str(calibration)


def _camera(draft: Draft) -> Case:
    calibration = _changed_calibration(draft)
    chosen = draft.rng.choice(("opencv", "ros", "mrcal", "kalibr"))
    name = "c.cameramodel" if chosen == "mrcal" else "c.yaml"
    words = ["convert", calibration, draft.output(name), "--format", chosen]
    return Case("convert calibration", words, {f"{OUT}/{name}"})


def _report(draft: Draft) -> Case:
    return Case("report", ["report", _changed_calibration(draft), "-o", draft.output("r.html")], {f"{OUT}/r.html"})


def _simulate(draft: Draft) -> Case:
    config = draft.take("rig.toml")
    draft.change(config, change_toml)
    # A file may ask for much work that is done in earnest, so only a part of the sweep is made.
    return Case("simulate", ["simulate", str(config), "-o", draft.output("made"), "--every", "200"], {f"{OUT}/made"})


def _rig(draft: Draft) -> Case:
    rng = draft.rng
    config = draft.take(rng.choice(("scan.toml", "desk.toml")))
    draft.change(config, change_toml)
    port = str(draft.folder / rng.choice(("missing", VICTIM, OUT)))
    words = rng.choice(
        (["scan", str(config), "-o", str(draft.folder / OUT / "new")], ["doctor", "--config", str(config)])
    )
    return Case(words[0], [*words, "--port", port])


def _words(draft: Draft) -> Case:
    """A valid command with words left out, doubled, exchanged, or nasty."""
    rng = draft.rng
    cloud, calibration, capture = draft.take("cloud.ply"), draft.take("calibration.json"), draft.take("unsealed")
    out = str(draft.folder / OUT / "x")
    words = rng.choice(
        (
            ["convert", str(cloud), out + ".xyz"],
            ["reconstruct", str(capture), "-c", str(calibration), "-o", out + ".ply", "--every", "3"],
            ["reconstruct", str(capture), "-c", str(calibration), "-o", out + ".ply", "--max-range", "4"],
            ["measure", "room", str(cloud), "-c", str(calibration)],
            ["measure", "plane", str(cloud), "--at", "1", "1", "0", "--radius-mm", "200"],
            ["report", str(calibration), "-o", out + ".html"],
            ["convert", str(calibration), out + ".yaml"],
        )
    )
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(words))
        match rng.randrange(5):
            case 0:
                del words[at]
            case 1:
                words.insert(at, words[at])
            case 2:
                words.insert(at, rng.choice(("--json", "--every", "-o", "--help", "--", "--bogus", "-1", "nan", "")))
            case 3:
                words[at] = rng.choice((strange_name(rng), str(nasty_number(rng))))
            case _:
                other = rng.randrange(len(words))
                words[at], words[other] = words[other], words[at]
        if not words:
            break
    outputs = {f"{OUT}/x{suffix}" for suffix in (".xyz", ".ply", ".html", ".yaml", "")}
    return Case("words", words, outputs, {f"{IN}/unsealed/stripes.npz"})


KINDS: dict[Callable[[Draft], Case], float] = {
    _reconstruct: 20,
    _reconstruct_with: 4,
    _repack: 8,
    _import: 6,
    _verify: 8,
    _calibrate: 0.5,
    _camera: 8,
    camera_case: 8,
    _report: 1,
    convert_cloud: 24,
    measure_cloud: 12,
    stranger_cloud: 16,
    make_product: 6,
    align_targets: 2,
    _simulate: 3,
    _rig: 3,
    _words: 4,
    project_case: 8,
    paper_case: 5,
    served_case: 3,
    wrong_angles: 0.5,
    hard_disk: 5,
    video_case: 4,
    many_lines: 0.5,
    recalibrate_case: 1,
    orders_case: 4,
}
"""The kinds of cases, and how often each comes."""
