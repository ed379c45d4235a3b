"""The command line itself: which verbs there are, that only the called one is loaded, and how mistakes are answered."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import jaxscan
from jaxscan.cli.main import main
from jaxscan.cli.verbs import BELOW, VERBS, load_verb
from jaxscan.errors import CloudError
from jaxscan.files.clouds import WRITERS


EVERY = [((name,), line) for name, line in VERBS.items()] + [
    ((first, name), line) for first, verbs in BELOW.items() for name, line in verbs.items()
]


def answer(capsys, *words):
    with pytest.raises(SystemExit) as exit:
        main(words)
    return exit.value.code, capsys.readouterr()


@pytest.mark.parametrize(("words", "line"), EVERY, ids=lambda one: " ".join(one) if isinstance(one, tuple) else "")
def test_the_table_says_the_same_as_the_docstring(words, line):
    assert " ".join(inspect.getdoc(load_verb(*words)).split()).startswith(line)


def test_help_lists_all_verbs_and_loads_none():
    code = (
        "import sys; from jaxscan.cli.main import main\n"
        "try: main(['--help'])\n"
        "except SystemExit as exit: print(exit.code, [m for m in ('jax', 'numpy', 'pydantic') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "0 []"
    assert all(f"\n  {verb} " in run.stdout for verb in VERBS)


def test_help_of_a_verb_loads_no_jax():
    code = (
        "import sys; from jaxscan.cli.main import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit as exit: print(exit.code, [m for m in ('jax', 'cv2') if m in sys.modules])"
    )
    words = ["measure", "room", "--help"]
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "0 []"


@pytest.mark.parametrize("words", [words for words, _ in EVERY], ids=" ".join)
def test_help_of_a_verb(words, capsys):
    code, said = answer(capsys, *words, "--help")
    assert code == 0
    assert said.out.startswith(f"usage: jaxscan {' '.join(words)} [-h]")
    options = ["-h, --help"] if words[0] in BELOW and len(words) == 1 else ["-h, --help", "--json FILE"]
    assert all(option in said.out for option in options)


@pytest.mark.parametrize("verb", ["convert", "reconstruct", "scan"])
def test_help_names_every_format_of_clouds(verb, capsys):
    _, said = answer(capsys, verb, "--help")
    assert " ".join(WRITERS) in " ".join(said.out.replace("│", " ").split())


def test_the_readme_names_every_format_of_clouds():
    readme = (Path(__file__).resolve().parents[2] / "README.md").read_text()
    (line,) = [line for line in readme.splitlines() if line.startswith("jaxscan.save_cloud(")]
    assert set(re.findall(r"\.\w+\b", line.split("(")[1])) == set(WRITERS)


@pytest.mark.parametrize(
    ("words", "suggested"),
    [
        (["calibrat"], "calibrate"),
        (["measure", "rom"], "room"),
        (["measure", "room", "a.ply", "--calib", "b"], "--calibration"),
    ],
)
def test_the_closest_name_is_suggested(words, suggested, capsys):
    code, said = answer(capsys, *words)
    assert code == 2
    assert suggested in said.err


@pytest.mark.parametrize("words", [[], ["measure"], ["calibrate"], ["--nonsense"], ["measure", "room", "a.ply", "--x"]])
def test_usage_errors_are_code_2(words, capsys):
    code, said = answer(capsys, *words)
    assert code == 2
    assert said.out == "" and said.err


def test_the_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"jaxscan {jaxscan.__version__}\n"


@pytest.mark.more
def test_a_rig_without_its_extra_is_one_line(tmp_path):
    (tmp_path / "rig.toml").write_text("[camera]\nkind = 'opencv'\nwidth = 64\nheight = 48\ntrigger = 'free'\n")
    code = "import sys; sys.modules['serial'] = None; from jaxscan.cli.main import main; sys.exit(main(sys.argv[1:]))"
    for words in (["doctor", "--port", "auto"], ["scan", "rig.toml", "-o", "made"]):
        run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, cwd=tmp_path)
        assert run.returncode == 1 and run.stderr.count("\n") == 1, run.stderr
        assert 'pip install "jaxscan[rig]"' in run.stderr and not (tmp_path / "made").exists()


def test_debug_shows_the_traceback(tmp_path, capsys):
    words = ["measure", "room", str(tmp_path / "none.ply")]
    assert main(words) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    with pytest.raises(CloudError, match=r"none\.ply"):
        main([*words, "--debug"])
