"""The public face: what the README promises, in-memory sweeps, and the form of every public function."""

import ast
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest.mock import create_autospec

import numpy as np
import pytest

import jaxscan
from jaxscan import api
from jaxscan.errors import CaptureError
from jaxscan.reconstruction.sweep import SweepSource


ROOT = Path(__file__).resolve().parent.parent
PUBLIC = sorted(name for name in jaxscan.__all__ if not name.startswith("_"))
FUNCTIONS = [name for name in PUBLIC if inspect.isfunction(getattr(jaxscan, name))]
VERBS = {
    *("calibrate", "recalibrate", "reconstruct", "reconstruct_capture", "extract_stripes", "extract"),
    *("simulate", "open_capture"),
    *("load_calibration", "save_calibration", "load_scanner", "load_cloud", "save_cloud"),
    *("fit_plane", "fit_axis", "measure_room", "measure_distance", "measure_plane", "compare_clouds"),
}
SUBJECTS = {
    "calibrate": ["captures"],
    "recalibrate": ["captures", "calibration"],
    "observe_boards": ["captures"],
    "reconstruct": ["sweep", "scanner"],
    "reconstruct_capture": ["capture", "scanner"],
    "extract": ["sweep", "scanner"],
    "extract_stripes": ["on", "off"],
    "simulate": ["config", "folder"],
}
"""What a verb works on may be given by place; how it works, by name alone."""


def test_public_names():
    assert set(FUNCTIONS) >= VERBS
    assert {"Sweep", "Scanner", "Stripes", "PointCloud", "Capture", "Calibration"} <= set(PUBLIC)
    assert {"JaxscanError", "Pinhole", "Fisheye", "LaserSheet", "Turntable", "SimulationConfig"} <= set(PUBLIC)
    assert {"Observations", "BoardViews", "StripeViews", "calibrate_observations", "create_capture"} <= set(PUBLIC)


def test_what_an_interactive_session_offers():
    assert dir(jaxscan) == sorted(jaxscan.__all__)
    assert not [name for name in dir(jaxscan) if inspect.ismodule(getattr(jaxscan, name))]
    assert re.fullmatch(r"\d+\.\d+\.\d+", jaxscan.__version__)
    with pytest.raises(AttributeError, match="no attribute 'Scaner'"):
        jaxscan.Scaner  # noqa: B018


def test_a_star_gives_every_public_name():
    names = {}
    exec("from jaxscan import *", names)
    assert set(jaxscan.__all__) <= set(names)


def test_the_list_of_names_is_one_that_type_checkers_read():
    tree = ast.parse(Path(jaxscan.__file__).read_text())
    (checked,) = [node for node in tree.body if isinstance(node, ast.If)]
    listed = {alias.name: node.module for node in checked.body for alias in node.names}
    assert sorted(listed) == PUBLIC
    # A home is a facade: a folder, or the file of the errors.
    assert all(module.count(".") == 1 for module in listed.values())


@pytest.mark.parametrize("name", FUNCTIONS)
class TestForm:
    def test_options_are_by_keyword(self, name):
        parameters = inspect.signature(getattr(jaxscan, name)).parameters.values()
        by_place = [p for p in parameters if p.kind is not inspect.Parameter.KEYWORD_ONLY]
        options = [p.name for p in by_place if p.default is not inspect.Parameter.empty]
        assert options == (["off"] if name == "extract_stripes" else [])
        if name in SUBJECTS:
            assert [p.name for p in by_place] == SUBJECTS[name]

    def test_docstring(self, name):
        function = getattr(jaxscan, name)
        text = inspect.getdoc(function)
        first, *rest = text.split("\n")
        assert first.endswith(".") and len(first) <= 110
        assert not rest or rest[0] == ""
        assert "\nArgs:\n" in text
        signature = inspect.signature(function)
        for parameter in signature.parameters:
            assert re.search(rf"^    {parameter}(, \w+)*: ", text, re.MULTILINE) or re.search(
                rf"^    (\w+, )+{parameter}(, \w+)*: ", text, re.MULTILINE
            ), f"{parameter} is not described"
        if signature.return_annotation is not None:
            assert "\nReturns:\n" in text

    def test_everything_is_annotated(self, name):
        signature = inspect.signature(getattr(jaxscan, name))
        assert signature.return_annotation is not inspect.Signature.empty
        assert all(p.annotation is not inspect.Parameter.empty for p in signature.parameters.values())


@pytest.fixture(params=["known calibration", pytest.param("whole way", marks=pytest.mark.slow)])
def calibrate(request, tiny, monkeypatch):
    """The call as it is, or one that takes the same and gives what it gave on the command line."""
    if request.param == "whole way":
        yield
        return
    known = jaxscan.load_calibration(tiny.calibration)
    same = create_autospec(jaxscan.calibrate, return_value=known)
    monkeypatch.setattr(jaxscan, "calibrate", same)
    yield
    (capture,) = same.call_args.args
    assert capture.digest() == jaxscan.open_capture(tiny.boards).digest()


@pytest.mark.usefixtures("calibrate")
def test_the_example_of_the_readme(tiny, tmp_path, monkeypatch, capsys):
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len([line for line in example.splitlines() if line]) <= 12
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "boards").symlink_to(tiny.boards)
    (tmp_path / "captures" / "room").symlink_to(tiny.sweep)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert all(re.fullmatch(r"\d\.\d{4} m, sigma \d+\.\d mm", line) for line in lines), lines
    assert (tmp_path / "room.ply").stat().st_size > 100_000


@pytest.mark.more
def test_type_checkers_accept_the_example_of_the_readme(tmp_path):
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    (tmp_path / "example.py").write_text(example)
    command = [sys.executable, "-m", "mypy", "--config-file", ROOT / "pyproject.toml", tmp_path / "example.py"]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stdout + run.stderr


def test_a_capture_and_a_sweep_are_sweeps_to_every_type_checker():
    """mypy takes a cached property for a property, and others do not."""
    for name, member in vars(SweepSource).items():
        if isinstance(member, property):
            assert isinstance(vars(jaxscan.Capture)[name], property), name
            assert name in jaxscan.Sweep.__annotations__ or isinstance(vars(jaxscan.Sweep)[name], property), name


@pytest.fixture(scope="module")
def in_memory(tiny):
    capture = jaxscan.open_capture(tiny.sweep)
    pairs = [capture.frames(index) for index in range(len(capture))]
    on, off = (np.stack([pair[k] for pair in pairs]) for k in (0, 1))
    return jaxscan.Sweep(on=on, off=off, angles=capture.angles, lasers=capture.lasers, carries=capture.carries)


@pytest.mark.more
def test_a_sweep_in_memory_gives_what_its_capture_gives(tiny, in_memory):
    scanner = jaxscan.load_scanner(tiny.calibration)
    seen = []
    from_memory = jaxscan.reconstruct(in_memory, scanner, progress=lambda done, total: seen.append((done, total)))
    from_disk = jaxscan.reconstruct(jaxscan.open_capture(tiny.sweep), scanner)
    for name in ("valid", "xyz", "rgb", "normals", "sigma_random", "sigma_systematic", "intensity", "angle"):
        np.testing.assert_array_equal(getattr(from_memory, name), getattr(from_disk, name), err_msg=name)
    assert seen[-1] == (60, 60) and seen == sorted(seen)


@pytest.mark.more
def test_python_gives_what_the_command_line_gives(tiny, in_memory):
    """Which goes by way of the stripes, so that it can keep them."""
    scanner = jaxscan.load_scanner(tiny.calibration)
    ours, theirs = jaxscan.reconstruct(in_memory, scanner), jaxscan.load_cloud(tiny.cloud)
    ours = jaxscan.colour_cloud(ours, jaxscan.open_capture(tiny.sweep), scanner)
    np.testing.assert_array_equal(ours.valid, theirs.valid)
    np.testing.assert_array_equal(ours.rgb, theirs.rgb)
    # One compiled function and two: the last places of float32, of lengths of metres.
    for name in ("xyz", "sigma_random", "sigma_systematic", "intensity"):
        np.testing.assert_allclose(
            getattr(ours, name)[ours.valid], getattr(theirs, name)[ours.valid], rtol=1e-5, atol=1e-5, err_msg=name
        )


def test_stripes_of_a_whole_sweep_serve_again(tiny, in_memory):
    scanner = jaxscan.load_scanner(tiny.calibration)
    stripes = jaxscan.extract(in_memory, scanner).stripes
    assert stripes.rgb is not None and stripes.valid.dtype == bool
    whole = jaxscan.reconstruct(in_memory, scanner)
    unread = jaxscan.Sweep(
        on=np.zeros_like(in_memory.on), off=None, angles=in_memory.angles, lasers=in_memory.lasers, carries="scanner"
    )
    again = jaxscan.reconstruct(unread, scanner, stripes=stripes)
    np.testing.assert_array_equal(again.valid, whole.valid)
    np.testing.assert_array_equal(again.rgb, whole.rgb)
    np.testing.assert_allclose(again.xyz, whole.xyz, rtol=1e-5, atol=1e-5)


@pytest.mark.more
def test_stripes_found_before_give_the_same_cloud(tiny, in_memory):
    """`extract_stripes` and `reconstruct` are the two halves of one way."""
    scanner = jaxscan.load_scanner(tiny.calibration)
    noise = jaxscan.NoiseModel(read_dn=1.0, electrons_per_dn=40.0)
    whole = jaxscan.reconstruct(in_memory, scanner, noise=noise)
    stripes = jaxscan.extract_stripes(in_memory.on, in_memory.off, line=in_memory.lasers[0], noise=noise)
    halves = jaxscan.reconstruct(in_memory, scanner, stripes=stripes)
    both = whole.valid & halves.valid
    # Compiled as one function and as two, so single precision may round a limit the other way.
    assert both.sum() >= max(whole.valid.sum(), halves.valid.sum()) - 5
    np.testing.assert_allclose(halves.xyz[both], whole.xyz[both], atol=1e-4)


@pytest.mark.slow
def test_the_library_works_as_it_comes(tiny):
    """Without the strict settings of the tests: 32 bit, any promotion, in a process of its own."""
    code = (
        "import jaxscan, numpy as np\n"
        f"cloud = jaxscan.reconstruct(jaxscan.open_capture({str(tiny.sweep)!r}).every(20),"
        f" jaxscan.load_scanner({str(tiny.calibration)!r}))\n"
        "import jax\n"
        "print(int(cloud.valid.sum()), cloud.xyz.dtype, jax.config.jax_enable_x64)\n"
    )
    run = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, env=os.environ)
    assert run.returncode == 0, run.stderr
    points, dtype, x64 = run.stdout.split()
    here = jaxscan.reconstruct(jaxscan.open_capture(tiny.sweep).every(20), jaxscan.load_scanner(tiny.calibration))
    assert (int(points), dtype, x64) == (int(here.valid.sum()), "float32", "False")


def test_a_calibration_names_what_it_was_made_from(tiny):
    calibration = jaxscan.load_calibration(tiny.calibration)
    (capture,) = calibration.provenance["captures"]
    assert capture == {"name": "boards", "digest": jaxscan.open_capture(tiny.boards).digest()}
    assert set(calibration.provenance["versions"]) >= {"jaxscan", "jax"}
    assert calibration.observations is not None


def test_what_python_refuses(tiny, tmp_path):
    with pytest.raises(CaptureError, match="at least one capture"):
        jaxscan.calibrate([])
    with pytest.raises(CaptureError, match="is a sweep"):
        jaxscan.calibrate(jaxscan.open_capture(tiny.sweep))
    with pytest.raises(CaptureError, match="only a sweep can be reconstructed"):
        jaxscan.reconstruct(jaxscan.open_capture(tiny.boards), jaxscan.load_scanner(tiny.calibration))
    config = jaxscan.load_simulation(tiny.config)
    with pytest.raises(ValueError, match="`every` must be at least 1"):
        jaxscan.simulate(config, tmp_path / "a", every=0)
    assert list(tmp_path.iterdir()) == []


def test_simulating_twice_gives_the_same(tiny, tmp_path):
    """The seed decides everything, and the captures it names are those on disk."""
    config = jaxscan.load_simulation(tiny.config)
    few = config.model_copy(update={"boards": config.boards.model_copy(update={"free_views": 0, "placements": 0})})
    made = jaxscan.simulate(few, tmp_path / "again", every=30)
    assert (made.board_pairs, made.sweep_pairs) == (0, 2)
    assert not made.boards.exists()
    for index, step in enumerate((0, 30)):
        for kind in ("on", "off"):
            again = made.sweep / kind / f"{index:06d}.zst"
            assert again.read_bytes() == (tiny.sweep / kind / f"{step:06d}.zst").read_bytes()
    assert api.SimulatedCaptures.of(made.folder) == made


def test_missing_board_angles_stand_alone(tiny, tmp_path):
    """A record without an angle is a placement of its own; its corners still count."""
    boards = shutil.copytree(tiny.boards, tmp_path / "boards")
    path = boards / "frames.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    # Without the seal, which an edited journal does not fit.
    records = [line for line in lines if "i" in line]
    last = records[-1]
    last["angle_deg"] = None
    path.write_text("".join(json.dumps(record) + "\n" for record in records))
    observed = jaxscan.observe_boards([jaxscan.open_capture(boards)], with_stripes=False)
    placement = observed.corners.placement
    assert len(placement) == 21
    assert np.count_nonzero(placement == placement[-1]) == 1
    assert np.count_nonzero(placement == placement[-2]) == 2
