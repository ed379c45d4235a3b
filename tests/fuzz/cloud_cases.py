"""Cases with clouds: read, converted, measured, and made into something."""

from pathlib import Path

from .archives import change_npz
from .draft import OUT, Case, Draft, changed_capture
from .nasty import nasty_number
from .texts import change_bytes, change_json, change_ply_header


CLOUDS = (".ply", ".npz", ".e57", ".las", ".laz", ".pcd", ".xyz", ".ptx")


def _changed_cloud(draft: Draft) -> Path:
    rng = draft.rng
    name = rng.choice(("cloud.ply", "foreign.ply", "cloud.npz", "cloud" + rng.choice(CLOUDS)))
    cloud = draft.take(name)
    if name == "cloud.npz":
        draft.change(cloud, change_npz)
    elif cloud.suffix != ".ply":
        draft.change(cloud, change_bytes)
    else:
        draft.change(cloud, rng.choice((change_ply_header, change_ply_header, change_bytes)))
    return cloud


def convert_cloud(draft: Draft) -> Case:
    cloud, suffix = _changed_cloud(draft), draft.rng.choice(CLOUDS)
    target = str(cloud) if draft.rng.random() < 0.02 else draft.output("cloud" + suffix)
    return Case(f"convert to {suffix}", ["convert", str(cloud), target], {f"{OUT}/cloud{suffix}"})


def measure_cloud(draft: Draft) -> Case:
    rng, cloud = draft.rng, str(_changed_cloud(draft))
    numbers = [str(rng.choice((rng.uniform(-2, 2), nasty_number(rng)))) for _ in range(6)]
    verb = rng.choice(
        (
            ["room", cloud],
            ["plane", cloud, "--at", *numbers[:3]],
            ["distance", cloud, "--a", *numbers[:3], "--b", *numbers[3:]],
            ["points", cloud, "--a", *numbers[:3], "--b", *numbers[3:]],
            ["sphere", cloud, "--near", *numbers[:3], "--radius", numbers[3]],
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
