"""What a verb loads before it works: its help, its version and its mistakes need no JAX."""

import subprocess
import sys
from typing import get_args

import pytest

from jaxscan.calibration import Block, CalibrationSettings, Part, RigKind
from jaxscan.cli import options
from jaxscan.files.calibration import CameraFormat
from jaxscan.files.recording import Storage
from jaxscan.geometry import CAMERAS, Carries, StripeAxis
from jaxscan.geometry.scanner import Up
from jaxscan.reconstruction import ReconstructSettings, Smooth
from jaxscan.report.prints import Paper
from jaxscan.stripes import Choice, LaserColour, PixelFormat


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
    "dask",
    "sqlalchemy",
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
    assert "tyro" in loaded
    assert not loaded & HEAVY


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["init", "--list"]])
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
        (options.Carries, Carries),
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
