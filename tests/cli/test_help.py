"""The words of the command line: help, answers to mistakes, completion by shells, and what is loaded for them."""

import inspect
import re
import shutil
import subprocess
import sys
from typing import get_args

import pytest

import jaxscan
from jaxscan.calibration import Block, CalibrationSettings, Part, RigKind
from jaxscan.cli import options
from jaxscan.cli.help import GROUPS, SHELLS, entries_of, paragraphs
from jaxscan.cli.main import main
from jaxscan.cli.verbs import BELOW, DESCRIPTION, VERBS, load_verb
from jaxscan.files.calibration import CameraFormat
from jaxscan.files.clouds import WRITERS
from jaxscan.files.recording import Storage
from jaxscan.geometry import CAMERAS, StripeAxis
from jaxscan.geometry.scanner import Up
from jaxscan.reconstruction import ReconstructSettings, Smooth
from jaxscan.report.prints import Paper
from jaxscan.stripes import Choice, LaserColour, PixelFormat


EVERY = [(verb,) for verb in VERBS if verb not in BELOW] + [(first, verb) for first in BELOW for verb in BELOW[first]]
PAGES = [(), *((first,) for first in BELOW), *EVERY]
UNPLAIN = ("{None}", "{", "None", "(default", "INT", "FLOAT", "STR", "TUPLE", "positional arguments", "╭", "│", "\x1b")


@pytest.mark.parametrize("words", PAGES, ids=" ".join)
def test_pages_are_plain_and_fit(words, run, monkeypatch):
    for columns in (40, 60, 80, 200):
        monkeypatch.setenv("COLUMNS", str(columns))
        ran = run(*words, "--help")
        assert ran.code == 0 and ran.err == ""
        assert not [sign for sign in UNPLAIN if sign in ran.out]
        assert max(map(len, ran.out.splitlines())) <= min(columns, 100)
        assert ran.out.startswith(f"usage: {' '.join(['jaxscan', *words])} [-h]")
    assert all(option in ran.out for option in ("-h, --help", *(["--json FILE"] if words in EVERY else ())))


@pytest.mark.parametrize("words", EVERY, ids=" ".join)
def test_every_name_has_words_of_its_own(words, run):
    function = load_verb(*words)
    said = " ".join(run(*words, "--help").out.split())
    for entry in entries_of(function):
        assert len(entry.text.split()) >= 2, entry
        assert re.fullmatch(r"[A-Z0-9 .]*|[A-Z]+-DEG|[\w+-]+(\|[\w+-]+)+( \.\.\.)?", entry.value), entry
        assert " ".join([", ".join(entry.names), entry.value]).strip() in said
        assert " ".join(entry.text.split()) in said
    assert paragraphs(function)[0] in said


@pytest.mark.parametrize("words", EVERY, ids=" ".join)
def test_every_verb_checks_its_paths_and_gives_json(words):
    """By itself or by a function of its file; what is refused there is tested with some verbs."""
    verb = load_verb(*words)
    source, module = inspect.getsource(verb), inspect.getmodule(verb)
    for name, other in vars(module).items():
        if inspect.isfunction(other) and other.__module__ == module.__name__ and re.search(rf"\b{name}\(", source):
            source += inspect.getsource(other)
    assert "check_paths(" in source and "emit_json(" in source


def test_all_pages_describe_different_things(run):
    said = [run(*words, "--help").out for words in PAGES]
    assert len({text.split("\n\n")[1] for text in said}) == len(PAGES)
    assert [text for text in said if " ".join(DESCRIPTION.split()) in " ".join(text.split())] == said[:1]


def test_the_first_page_has_each_verb_in_one_group(run):
    grouped = [verb for verbs in GROUPS.values() for verb in verbs]
    assert sorted(grouped) == sorted(set(grouped)) and set(grouped) <= set(VERBS)
    assert all(run("--help").out.count(f"\n  {verb} ") == 1 for verb in VERBS)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["calbrate"], '"calbrate" is no verb of jaxscan. Did you mean "calibrate"?'),
        (["measure", "rom"], '"rom" is no verb of jaxscan measure. Did you mean "room"?'),
        (["xyzzy"], '"xyzzy" is no verb of jaxscan. All there are'),
        (["--versoin"], 'Did you mean "--version"?'),
        (["calibrate", "x", "--outptu", "y"], 'no option of jaxscan calibrate. Did you mean "--output"?'),
        (["calibrate", "x", "--outptu=y"], '"--outptu" is no option of jaxscan calibrate. Did you mean "--output"?'),
        (["measure", "room", "a.ply", "--calib", "b"], 'Did you mean "--calibration"?'),
        (["measure", "room", "a.ply", "-z"], '"-z" is no option of jaxscan measure room.'),
        (["calibrate", "x"], "jaxscan calibrate needs --output PATH: "),
        (
            ["clean", "a room.ply", "--thin-mm", "20"],
            "Type for example: jaxscan clean 'a room.ply' --thin-mm 20 -o 'a room-clean.ply'. ",
        ),
        (["mesh", "far/room.ply"], "Type for example: jaxscan mesh far/room.ply -o room-mesh.glb. "),
        (["reconstruct", "-c", "x", "-o", "y"], "jaxscan reconstruct needs CAPTURE: "),
        (["calibrate", "x", "-o"], "-o needs PATH."),
        (["calibrate", "x", "-o", "y", "--at-m", "far"], '--at-m: found "far", expected a number.'),
        (["simulate", "x", "-o", "y", "--every", "1.5"], '--every: found "1.5", expected a whole number.'),
        (["calibrate", "x", "-o", "y", "--lens", "wide"], '--lens: found "wide", expected one of pinhole, '),
        (["calibrate", "x", "-o", "y", "--free", "focal", "lase"], '--free: found "lase", expected one of focal, '),
        (["measure", "distance", "a", "--a", "1", "-2", "--b", "1", "2", "3"], "--a needs NUMBER NUMBER NUMBER."),
        (["measure", "compare", "a"], "jaxscan measure compare needs CLOUD: "),
        (["calibrate", "x", "-o", "y", "--redetect=no"], "--redetect takes no value."),
        (["measure", "compare", "a", "b", "c"], '"c" is one word too many for jaxscan measure compare.'),
        (["--nonsense"], '"--nonsense" is no option of jaxscan.'),
        (["plan", "x", "-o", "y", "--height"], "--height needs NUMBER. More"),
        (["info", "x", "--help=y"], "--help takes no value."),
        (["measure", "--json", "-"], '"--json" is no option of jaxscan measure. It follows the verb. '),
        (["--version", "info"], '"--version" is no option of jaxscan. It stands alone. '),
        (["--completion"], "--completion needs the name of a shell: bash, zsh."),
        (["--completion", "csh"], "--completion needs the name of a shell"),
    ],
)
def test_a_mistake_is_one_line(words, says, run):
    ran = run(*words)
    assert ran.code == 2 and ran.out == ""
    assert ran.err.startswith("jaxscan: ") and ran.err.count("\n") == 1
    assert says in ran.err


@pytest.mark.parametrize(
    "words",
    [
        ["measure", "distance", "none.ply", "--a", "-1", "-2e0", "1", "--b=1", "2", "3", "--radius_mm", "4"],
        ["measure", "room", "none.ply", "--up", "-x"],
        ["import", "none", "-o", "made", "--up", "-v", "--step-deg", "-0.9"],
        ["reconstruct", "none", "-c", "none.json", "-o", "made.ply", "--no-cache"],
        ["calibrate", "-o", "made.json", "--no-redetect", "none", "--free", "focal", "bow"],
    ],
    ids=" ".join,
)
def test_words_that_are_none_are_not_taken_for_mistakes(words, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran = run(*words)
    assert (ran.code, ran.err.count("\n")) == (1, 1) and "none" in ran.err, ran.err


@pytest.fixture(scope="module")
def bash(tmp_path_factory):
    """Completes typed words by the script for bash."""
    script = tmp_path_factory.mktemp("completion") / "jaxscan.bash"
    with script.open("w") as file, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdout", file)
        assert main(["--completion", "bash"]) == 0
    subprocess.run(["bash", "-n", script], check=True)

    def complete(*words):
        typed = f'source "$0"; COMP_WORDS=("$@"); COMP_CWORD={len(words)}; _jaxscan; echo "${{COMPREPLY[@]}}"'
        ran = subprocess.run(
            ["bash", "-c", typed, script, "jaxscan", *words], capture_output=True, text=True, check=True
        )
        assert ran.stderr == ""
        return ran.stdout.split()

    return complete


def test_bash_completes_verbs_options_and_choices(bash):
    assert bash("calib") == ["calibrate"]
    assert bash("--v") == ["--version"]
    assert bash("")[: len(VERBS)] == list(VERBS)
    assert bash("measure", "ro") == ["room"]
    assert bash("measure", "room", "--u") == ["--unit", "--up"]
    assert bash("calibrate", "captures", "--ou") == ["--output"]
    assert bash("calibrate", "captures", "--lens", "") == list(CAMERAS)
    # Names of files are the shell's own.
    assert bash("calibrate", "captures/bo") == []


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_name_every_verb_and_option(shell, run):
    ran = run("--completion", shell)
    assert ran.code == 0 and ran.err == ""
    for words in EVERY:
        assert words[-1] in ran.out
        for entry in entries_of(load_verb(*words)):
            long = [name for name in entry.names if name.startswith("--")]
            assert all(name in ran.out for name in long)
    program = shutil.which(shell)
    if program is not None:
        subprocess.run([program, "-n"], input=ran.out, text=True, check=True)


@pytest.mark.parametrize("words", [[], ["measure"]])
def test_without_a_verb_the_verbs_are_listed(words, run):
    ran = run(*words)
    assert ran.code == 2 and ran.out == "" and "VERB" in ran.err


LINES = [((name,), line) for name, line in VERBS.items()] + [
    ((first, name), line) for first, verbs in BELOW.items() for name, line in verbs.items()
]


@pytest.mark.parametrize(("words", "line"), LINES, ids=lambda one: " ".join(one) if isinstance(one, tuple) else "")
def test_the_table_says_the_same_as_the_docstring(words, line):
    assert " ".join(inspect.getdoc(load_verb(*words)).split()).startswith(line)


@pytest.mark.parametrize("verb", ["convert", "reconstruct", "scan"])
def test_help_names_every_format_of_clouds(verb, run):
    assert " ".join(WRITERS) in " ".join(run(verb, "--help").out.split())


def test_the_version(run):
    assert run("--version") == (0, f"jaxscan {jaxscan.__version__}\n", "")


@pytest.mark.more
def test_a_rig_without_its_extra_is_one_line(tmp_path):
    (tmp_path / "rig.toml").write_text("[camera]\nkind = 'opencv'\nwidth = 64\nheight = 48\ntrigger = 'free'\n")
    code = "import sys; sys.modules['serial'] = None; from jaxscan.cli.main import main; sys.exit(main(sys.argv[1:]))"
    for words in (["doctor", "--port", "auto"], ["scan", "rig.toml", "-o", "made"]):
        run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, cwd=tmp_path)
        assert run.returncode == 1 and run.stderr.count("\n") == 1, run.stderr
        assert 'pip install "jaxscan[rig]"' in run.stderr and not (tmp_path / "made").exists()


HEAVY = {
    "jax",
    "equinox",
    "numba",
    "optimistix",
    "scipy",
    "cv2",
    "matplotlib",
    "pydantic",
    "aiohttp",
}
EVERY_PAGE = """
import sys
from jaxscan.cli import verbs
from jaxscan.cli.help import verb_page
pages = [(name,) for name in verbs.VERBS] + [(first, name) for first, names in verbs.BELOW.items() for name in names]
for words in pages:
    assert verb_page(" ".join(words), verbs.load_verb(*words)), words
print(*sys.modules)
"""


def loaded_by(*words):
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in done.stdout.split()}


def test_the_help_of_all_verbs_loads_nothing_heavy():
    loaded = loaded_by("-c", EVERY_PAGE)
    assert "jaxscan" in loaded and not loaded & HEAVY


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["init", "--list"]], ids=" ".join)
def test_what_computes_nothing_loads_nothing_heavy(words):
    code = (
        "import sys; from jaxscan.cli.main import main\n"
        f"try: main({words!r})\n"
        "except SystemExit: pass\n"
        "print(*sys.modules)"
    )
    assert not loaded_by("-c", code) & (HEAVY - {"pydantic"})


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (options.Part, Part),
        (options.RigKind, RigKind),
        (options.Block, Block),
        (options.Choice, Choice),
        (options.Smooth, Smooth),
        (options.Paper, Paper),
        (options.CameraFormat, CameraFormat),
        (options.Storage, Storage),
        (options.PixelFormat, PixelFormat),
        (options.LaserColour, LaserColour),
        (options.StripeAxis, StripeAxis),
        (options.ImageUp, Up),
    ],
)
def test_choices_are_those_of_the_rooms(ours, theirs):
    assert get_args(ours) == get_args(theirs)


def test_choices_that_rooms_collect():
    assert CalibrationSettings().camera in CAMERAS
    usual = ReconstructSettings()
    assert (options.MIN_RANGE_M, options.MAX_RANGE_M) == (usual.min_range_m, usual.max_range_m)
    assert usual.smooth == "edge"
