"""Cases with clouds: read, converted, measured, and made into something."""

from pathlib import Path

from jaxscan.files.clouds import FORMATS

from .archives import change_npz
from .draft import OUT, Case, Draft, changed_capture
from .nasty import nasty_number
from .scans import change_e57, change_las, change_pcd, change_ptx, change_xyz
from .texts import change_bytes, change_json, change_lines, change_ply_header, change_toml


CLOUDS = tuple(FORMATS)
_CHANGES = {
    ".npz": change_npz,
    ".e57": change_e57,
    ".las": change_las,
    ".laz": change_las,
    ".pcd": change_pcd,
    ".xyz": change_xyz,
    ".ptx": change_ptx,
}


_TEXT_CHANGES = (change_xyz, change_lines, change_bytes)


def _changed_cloud(draft: Draft) -> Path:
    rng = draft.rng
    name = rng.choice(("cloud.e57", *("cloud" + rng.choice(CLOUDS) for _ in range(4))))
    cloud = draft.take(name)
    own = _CHANGES.get(cloud.suffix, rng.choice((change_ply_header, change_ply_header, change_bytes)))
    draft.change(cloud, own)
    return cloud


def convert_cloud(draft: Draft) -> Case:
    cloud, suffix = _changed_cloud(draft), draft.rng.choice(CLOUDS)
    target = str(cloud) if draft.rng.random() < 0.02 else draft.output("cloud" + suffix)
    words = ["convert", str(cloud), target]
    if draft.rng.random() < 0.15:
        numbers = [str(draft.rng.choice((500_000.0, nasty_number(draft.rng)))) for _ in range(3)]
        words += draft.rng.choice((["--epsg", numbers[0]], ["--offset", *numbers], ["--unit", "foot"], ["--up", "-y"]))
    return Case(f"convert {cloud.suffix} to {suffix}", words, {f"{OUT}/cloud{suffix}"})


_READINGS = {
    "--columns": (
        *("x,y,z", "x,y,z,i,r,g,b", "-,x,y,z", "x,y,z,nx,ny,nz", "x,y", "x,y,z,x", "x,y,z,,,,", "i,r,g,b,z,y,x"),
        "x,y,z" + ",-" * 300,
    ),
    "--colours": ("1", "255", "1023", "65535", "none"),
    "--unit": ("mm", "foot", "us-foot"),
}


def stranger_cloud(draft: Draft) -> Case:
    """A cloud of another program, changed or not, perhaps read as somebody says."""
    rng = draft.rng
    names = sorted(path.name for path in draft.corpus.glob("stranger-*"))
    cloud, target = draft.take(rng.choice(names)), "cloud" + rng.choice(CLOUDS)
    if rng.random() < 0.85:
        ply = (change_ply_header, change_ply_header, change_bytes)
        draft.change(cloud, _CHANGES.get(cloud.suffix, rng.choice(ply if cloud.suffix == ".ply" else _TEXT_CHANGES)))
    words = ["convert", str(cloud), draft.output(target)]
    for option, values in _READINGS.items():
        if rng.random() < 0.15:
            words += [option, rng.choice(values)]
    return Case(f"stranger {cloud.suffix}", words, {f"{OUT}/{target}"})


def align_targets(draft: Draft) -> Case:
    """Targets with changed values; of one with a coordinate of the wrong sign a word is needed."""
    rng, targets, cloud = draft.rng, draft.take("targets.toml"), draft.take("cloud.npz")
    sign = rng.random() < 0.3
    if sign:
        text = targets.read_text()
        at = rng.choice([k for k in range(len(text) - 1) if text[k : k + 6] == "site ="]) + 8
        targets.write_text(text[:at] + ("-" if text[at] != "-" else "") + text[at + (text[at] == "-") :])
    else:
        draft.change(targets, change_toml)
    words = ["align", str(cloud), "-o", draft.output("a.npz"), "--targets", str(targets)]
    return Case("align sign" if sign else "align targets", words, {f"{OUT}/a.npz"}, needs_word=sign)


def measure_cloud(draft: Draft) -> Case:
    rng, cloud = draft.rng, str(_changed_cloud(draft))
    numbers = [str(rng.choice((rng.uniform(-2, 2), nasty_number(rng)))) for _ in range(6)]
    verb = rng.choice(
        (
            ["room", cloud],
            ["plane", cloud, "--at", *numbers[:3]],
            ["distance", cloud, "--a", *numbers[:3], "--b", *numbers[3:]],
            ["points", cloud, "--a", *numbers[:3], "--b", *numbers[3:]],
            ["sphere", cloud, "--near", *numbers[:3], "--radius-mm", numbers[3]],
            ["deviations", cloud, "--at", *numbers[:3], "-o", draft.output("m.png")],
            ["compare", cloud, str(draft.take("cloud.npz"))]
            if not cloud.endswith("cloud.npz")
            else ["compare", cloud, str(draft.take("cloud.ply"))],
        )
    )
    words = ["measure", *verb]
    if rng.random() < 0.3:
        calibration = draft.take("calibration.json")
        draft.change(calibration, change_json)
        words += ["--radius-mm", numbers[5]] if verb[0] in ("plane", "deviations") else ["-c", str(calibration)]
    if rng.random() < 0.3:
        words += ["--json", rng.choice(("-", str(draft.folder / OUT / "m.json"), verb[1]))]
    return Case(f"measure {verb[0]}", words, {f"{OUT}/m.json", f"{OUT}/m.png"})


def make_product(draft: Draft) -> Case:
    """What is made of a cloud."""
    rng = draft.rng
    if rng.random() < 0.2:
        capture, calibration = changed_capture(draft, "unsealed"), draft.take("calibration.json")
        words = ["panorama", str(capture), "-c", str(calibration), "--width", "128", "-o", draft.output("p.jpg")]
        return Case("panorama", words, {f"{OUT}/p.jpg"})
    cloud = str(_changed_cloud(draft))
    verb, name = rng.choice(
        (
            ("mesh", "m.glb"),
            ("mesh", "m.obj"),
            ("plan", "p.svg"),
            ("plan", "p.dxf"),
            ("orthophoto", "w"),
            ("align", "a.npz"),
        )
    )
    words = [verb, cloud, "-o", draft.output(name), *(["--room"] if verb == "align" else [])]
    return Case(verb, words, {f"{OUT}/{name}", f"{OUT}/m.mtl"})
