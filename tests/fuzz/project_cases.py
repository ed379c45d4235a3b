"""Cases with projects, rooms, boards and rigs on paper: files that people write, and folders of strangers."""

import os
import random
from collections.abc import Callable
from pathlib import Path

from .archives import change_npz
from .draft import IN, OUT, VICTIM, Case, Draft, changed_capture
from .nasty import nasty_number, nasty_text
from .pictures import change_image
from .places import strange_name
from .texts import change_bytes, change_json, change_toml, dump


PROJECT = """[project]
name = "room"
products = ["cloud"]
formats = ["ply"]

[[rig]]
name = "one"
calibration = "calibration.json"

[[captures]]
pattern = "unsealed"
rig = "one"
"""
TARGETS = """[[target]]
name = "a"
scanner = [1.0, 0.5, 0.25]
site = [11.0, 20.5, 5.25]
[[target]]
name = "b"
scanner = [-1.0, 0.75, 0.5]
site = [9.0, 20.75, 5.5]
[[target]]
name = "c"
scanner = [0.25, -1.5, 1.0]
site = [10.25, 18.5, 6.0]
[[target]]
name = "d"
scanner = [0.5, 1.25, -0.75]
site = [10.5, 21.25, 4.25]
"""
KNOWN = """[[length]]
metres = 3.2
sigma_mm = 1.0
a = [-1.5, 0.0, 0.0]
b = [1.7, 0.0, 0.0]
"""
_LOCKS = (".batch.lock", "catalogue.sqlite", "project.json", "clouds", "catalogue.sqlite-journal")


def _change_database(rng: random.Random, data: bytes) -> bytes:
    return change_bytes(rng, data or b"SQLite format 3\0" + bytes(4000))


def project_case(draft: Draft) -> Case:
    """A project's folder of a stranger: its file, its captures, links in the place of locks and of the catalogue."""
    rng, folder = draft.rng, draft.folder / IN
    draft.take("unsealed"), draft.take("calibration.json")
    file, products = folder / "project.toml", folder / "products"
    file.write_text(PROJECT)
    if rng.random() < 0.5:
        draft.change(file, change_toml)
    elif rng.random() < 0.5:
        place = rng.choice(
            (
                f"sqlite:///{draft.folder / 'made.sqlite'}",
                f"sqlite:///{draft.folder.parent / 'outside.sqlite'}",
                "postgresql://127.0.0.1/x",
            )
        )
        text = PROJECT.replace('name = "room"', f'name = "room"\ncatalogue = "{place}"', 1)
        file.write_text(text.replace('"unsealed"', rng.choice(('"unsealed"', '"/etc/*"', '"*" * 9', '"../**/*"'))))
    if rng.random() < 0.6:
        products.mkdir()
        for name in rng.sample(_LOCKS, rng.choice((1, 1, 2))):
            victim = draft.folder / VICTIM
            match rng.randrange(5):
                case 0 | 1:
                    (products / name).symlink_to(rng.choice((victim, draft.folder / "missing", "/dev/full")))
                case 2:
                    os.link(victim, products / name)
                case 3:
                    (products / name).write_bytes(_change_database(rng, b"{}"))
                case _:
                    os.mkfifo(products / name)
    elif rng.random() < 0.3:
        products.symlink_to(draft.folder / "missing")
    kept = {f"{IN}/products", f"{IN}/unsealed/stripes.npz"}
    verb = rng.choice(("status", "status", "compare", "init", "view", "claim"))
    if verb == "claim":
        return Case("project claim", [], set(), kept if not products.is_symlink() else set(), drive=_claim(file))
    words = {
        "status": ["project", "status", str(file), *(["--all"] if rng.random() < 0.3 else [])],
        "compare": ["project", "compare", str(file), str(file)],
        "init": ["project", "init", str(folder)],
        "view": ["view", str(file), "--no-open", "--web-port", "0"],
    }[verb]
    if verb == "init" and rng.random() < 0.7 and (file.is_symlink() or not file.is_dir()):
        file.unlink(missing_ok=True)
    # What only looks makes nothing; `init` writes the file.
    allowed = frozenset({"network"}) if verb == "view" or "postgresql" in file_text(file) else frozenset[str]()
    return Case(f"project {verb}", words, {f"{IN}/project.toml"} if verb == "init" else set(), allowed=allowed)


def file_text(path: Path) -> str:
    """What a file of the case says; "" of what is no file."""
    if not path.is_file() or path.is_symlink():
        return ""
    with open(path, errors="replace") as file:
        return file.read(1 << 20)


def _claim(file: Path) -> Callable[[], list[str]]:
    def drive() -> list[str]:
        from jaxscan.errors import JaxscanError
        from jaxscan.project import load_project
        from jaxscan.project.project import claimed

        try:
            with claimed(load_project(file)):
                return []
        except JaxscanError as problem:
            return ["lines"] if "\n" in str(problem) else []

    return drive


def paper_case(draft: Draft) -> Case:
    """Boards, designs, configurations, checks of this machine."""
    rng = draft.rng
    number = str(nasty_number(rng))
    length = rng.choice(("4m", "25cm", number, f"{number}m", "1e9km", nasty_text(rng).replace("\0", "")[:500], "-1mm"))
    if rng.random() < 0.5:
        config = draft.take("rig.toml")
        draft.change(config, change_toml)
        paper = rng.choice(("A4", "A3", "letter", "A9"))
        words = ["board", str(config), "-o", draft.output("b" + rng.choice((".pdf", ".svg"))), "--paper", paper]
        return Case("board", words, {f"{OUT}/b.pdf", f"{OUT}/b.svg", *(f"{OUT}/b-{k}.svg" for k in range(1, 100))})
    words = rng.choice(
        (
            ["design", "--range", length, "--sigma", rng.choice(("1mm", length)), "--save-rig", draft.output("r.toml")],
            ["design", "--range", "4", "--sigma", "1mm", rng.choice(("--lens", "--baseline", "--pixel")), length],
            ["init", rng.choice(("scan.toml", "paper", strange_name(rng))), "-o", draft.output("s.toml")],
            ["doctor", "--config", str(draft.take("scan.toml")), "--camera", strange_name(rng)],
        )
    )
    words = [word.replace("\0", "") for word in words]
    return Case(words[0], words, {f"{OUT}/r.toml", f"{OUT}/s.toml"})


def served_case(draft: Draft) -> Case:
    """View and console up to the moment in which they serve: arguments, panoramas, configurations, folders."""
    rng = draft.rng
    hosts = ("127.0.0.1", "localhost", "::1", "", "256.1.1.1", "a" * 300, "-x", "evil.invalid", "0.0.0.0 ", "\x1b[31m")
    host, port = rng.choice((*hosts, strange_name(rng).replace("\0", ""))), rng.choice(("0", "0", "-1", "65536", "1e3"))
    where = ["--host", host, "--web-port", port]
    if rng.random() < 0.4:
        config, captures = draft.take("scan.toml"), draft.take("sealed")
        draft.change(config, change_toml)
        words = ["console", str(config), "--captures", str(captures.parent), *where]
        return Case("console", words, allowed=frozenset({"network"}))
    cloud, picture = draft.take("cloud.npz"), draft.take("panorama.jpg")
    if rng.random() < 0.3:
        draft.change(cloud, change_npz)
    else:
        draft.change(picture, rng.choice((change_bytes, change_image)))
    words = ["view", str(cloud), "--panorama", str(picture), "--no-open", *where]
    return Case("view", words, allowed=frozenset({"network"}))


def wrong_angles(draft: Draft) -> Case:
    """Angles in radians, as a script would write them: nothing is damaged, and all is wrong."""
    import json

    capture, calibration = draft.take("turning"), draft.take("calibration.json")
    journal = capture / "frames.jsonl"
    records = [json.loads(line) for line in journal.read_text().splitlines()]
    for record in records:
        if "angle_deg" in record:
            record["angle_deg"] = record["angle_deg"] * 0.017453292519943295
    journal.write_bytes(b"".join(dump(record) + b"\n" for record in records))
    words = ["reconstruct", str(capture), "-c", str(calibration), "--no-cache", "-o", draft.output("cloud.npz")]
    return Case("unsealed angles", words, {f"{OUT}/cloud.npz"}, cloud=f"{OUT}/cloud.npz", needs_word=True)


def hard_disk(draft: Draft) -> Case:
    """Valid inputs on a disk that is full, or in folders that cannot be written: nothing may be left."""
    rng = draft.rng
    cloud, calibration, capture = draft.take("cloud.npz"), draft.take("calibration.json"), draft.take("unsealed")
    out = draft.folder / OUT
    words = rng.choice(
        (
            *(["convert", str(cloud), str(out / f"c{suffix}")] for suffix in (".ply", ".e57", ".laz", ".pcd", ".xyz")),
            ["convert", str(capture), str(out / "new"), "--storage", rng.choice(("png", "npy", "zstd"))],
            ["convert", str(calibration), str(out / "c.yaml"), "--format", "opencv"],
            ["import", str(capture), "-o", str(out / "new"), "--step-deg", "1"],
            ["mesh", str(cloud), "-o", str(out / "m.glb")],
            ["board", str(draft.take("rig.toml")), "-o", str(out / "b.pdf")],
        )
    )
    written = {f"{OUT}/{Path(words[k]).name}" for k in range(len(words)) if words[k].startswith(str(out))}
    if rng.random() < 0.5:
        return Case(f"full disk: {words[0]}", words, written, most_bytes=rng.choice((4096, 10_000, 60_000)))
    return Case(f"read-only: {words[0]}", words, written, read_only=(out,))


def video_case(draft: Draft) -> Case:
    """A video that is cut or damaged; of one that is cut short a word is needed."""
    rng, folder = draft.rng, draft.folder / IN / "film"
    folder.mkdir()
    name = rng.choice(("film.avi", "film.mp4"))
    data = (draft.corpus / name).read_bytes()
    cut = rng.random() < 0.3
    data = data[: int(len(data) * rng.uniform(0.3, 0.9))] if cut else change_bytes(rng, data)
    (folder / name).write_bytes(data)
    words = ["import", str(folder), "-o", draft.output("new"), "--on", name, "--step-deg", "1"]
    words += rng.choice(([], [], ["--every", "3"], ["--off", name], ["--show"]))
    return Case("cut video" if cut else "video", words, {f"{OUT}/new"}, needs_word=cut)


def many_lines(draft: Draft) -> Case:
    """Very many tables or records, in little room."""
    rng, many = draft.rng, draft.rng.choice((3000, 10_000, 30_000))
    if rng.random() < 0.5:
        config = draft.take(rng.choice(("rig.toml", "scan.toml")))
        table = rng.choice((b"[t%d]\n", b"[[laser]]\nname = 'a%d'\n", b"[a.b%d]\nc = 1\n", b"k%d = 1\n"))
        config.write_bytes(config.read_bytes() + b"\n" + b"".join(table % k for k in range(many)))
        return Case("many tables", ["doctor", "--config", str(config)])
    capture = draft.take("unsealed")
    journal = capture / "frames.jsonl"
    first = journal.read_bytes().splitlines()[0]
    line = rng.choice((b'{"event": "e%d"}\n', first.replace(b'"i": 0', b'"i": %d') + b"\n"))
    if b"%d" not in line:
        line = b'{"event": "x%d"}\n'
    journal.write_bytes(journal.read_bytes() + b"".join(line % (k + 100) for k in range(many)))
    return Case("many records", ["doctor", "--capture", str(capture)])


def recalibrate_case(draft: Draft) -> Case:
    """Recalibration of captures that are too small for it, with changed files beside them."""
    rng, capture = draft.rng, changed_capture(draft, "unsealed")
    calibration, known = draft.take("calibration.json"), draft.take("known.toml")
    draft.take("calibration.npz")
    rng.choice(
        (
            lambda: draft.change(calibration, change_json),
            lambda: draft.change(known, change_toml),
            lambda: draft.change(draft.folder / IN / "calibration.npz", change_npz),
        )
    )()
    words = ["recalibrate", str(capture), "-c", str(calibration), "-o", draft.output("n.json"), "--known", str(known)]
    return Case("recalibrate", words, {f"{OUT}/n.json", f"{OUT}/n.npz"}, {f"{IN}/unsealed/stripes.npz"})
