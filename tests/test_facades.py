"""Facades load what is used, and nothing else."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import jaxscan.reconstruction
from jaxscan.errors import JaxscanError
from tests.every_file import for_every, tree_of


ROOT = Path(__file__).resolve().parent.parent
FACADES = [path for path in (ROOT / "jaxscan").rglob("__init__.py") if "load_on_use" in path.read_text()]


def loaded_by(code):
    """The modules of jaxscan, and others that are heavy, that a process has loaded after some lines."""
    shown = "; import sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code + shown], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_a_facade_loads_nothing_by_itself():
    loaded = loaded_by("import jaxscan.calibration, jaxscan.geometry, jaxscan.files, jaxscan.api")
    assert not loaded & {"jax", "numpy", "scipy", "ast", "re", "jaxscan.calibration.result"}


def test_a_name_loads_its_own_module():
    loaded = loaded_by("from jaxscan.files.clouds import load_cloud")
    assert "jaxscan.files.clouds.clouds" in loaded
    assert not loaded & {"jaxscan.calibration", "jaxscan.stripes", "scipy", "cv2"}


def test_a_function_is_not_hidden_by_the_module_of_its_name():
    import jaxscan.reconstruction.reconstruct

    assert callable(jaxscan.reconstruction.reconstruct)
    assert isinstance(sys.modules["jaxscan.reconstruction.reconstruct"], ModuleType)


@for_every(FACADES)
def test_every_name_that_type_checkers_read_is_loaded(path):
    facade = importlib.import_module(".".join(path.parent.relative_to(ROOT).parts))
    (checked,) = [node for node in tree_of(path).body if isinstance(node, ast.If)]
    listed = [alias.asname or alias.name for node in checked.body for alias in node.names]
    assert set(dir(facade)) - {"__version__"} == set(listed)


def test_a_name_that_is_not_listed():
    with pytest.raises(AttributeError, match=r"module 'jaxscan.reconstruction' has no attribute 'recontsruct'"):
        jaxscan.reconstruction.recontsruct  # noqa: B018
    assert "recontsruct" not in dir(jaxscan.reconstruction)


def test_a_public_name_of_the_package_itself():
    assert jaxscan.JaxscanError is JaxscanError
    assert {"__version__", "JaxscanError"} <= set(jaxscan.__all__)
