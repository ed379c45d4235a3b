"""Fixtures of rigs without hardware; tests whose tools are missing are skipped, with the reason."""

import importlib.util
import os
from pathlib import Path

import pytest


REQUIRED = bool(os.environ.get("JAXSCAN_REQUIRE_BENCH"))


def _refuse_or_skip(reason):
    if REQUIRED:
        raise pytest.UsageError(f"JAXSCAN_REQUIRE_BENCH is set, but {reason}")
    return pytest.mark.skip(reason=reason)


def missing_for_the_rig():
    """The missing tools of the simulated rig, as one line; "" if none is missing."""
    from bench.processes import missing_tools

    packages = missing_tools()
    return f"the simulated rig needs {', '.join(packages)}: type `make bench-deps`" if packages else ""


def missing_for_the_loopback():
    """The missing library of a camera on loopback, as one line; "" if it is there."""
    from bench.camera import aravis_is_there

    return "" if aravis_is_there() else "a camera on loopback needs libaravis-0.8-0: type `make bench-deps`"


def missing_for_the_camera():
    """The missing package of the rendered camera, as one line; "" if it is there."""
    return "" if importlib.util.find_spec("embreex") else "the rendered camera needs embreex"


NEEDS = {
    "rig": [missing_for_the_rig],
    "loopback": [missing_for_the_loopback],
    "rendered_camera": [missing_for_the_camera],
    "whole_bench": [missing_for_the_rig, missing_for_the_loopback, missing_for_the_camera],
}
"""Fixtures that need tools, with the functions that name missing ones."""


@pytest.hookimpl(tryfirst=True)  # Before pytest leaves out what -m does not name.
def pytest_collection_modifyitems(items):
    """Marks the tests that need tools `rig`, and skips them where tools are missing.

    With JAXSCAN_REQUIRE_BENCH=1 a missing tool is an error instead.
    """
    here = [item for item in items if item.path.is_relative_to(Path(__file__).parent)]
    for name, checks in NEEDS.items():
        wanting = [item for item in here if name in getattr(item, "fixturenames", ())]
        for item in wanting:
            item.add_marker(pytest.mark.rig)
        if wanting and (reason := next((said for check in checks if (said := check())), "")):
            mark = _refuse_or_skip(reason)
            for item in wanting:
                item.add_marker(mark)


@pytest.fixture
def rig(tmp_path):
    """Makes simulated rigs, `rig(speed=…, …)`, each in its own folder; all are switched off at the end."""
    from bench import RigOptions, SimulatedRig

    made = []

    def make(**options):
        simulated = SimulatedRig(tmp_path / f"rig{len(made)}", RigOptions(**options))
        made.append(simulated)
        simulated.start()
        return simulated

    yield make
    for simulated in made:
        simulated.close()


@pytest.fixture
def loopback():
    """Exclusive use of the only address of a GigE Vision camera, 127.0.0.1, since tests run in parallel."""
    from bench.camera import ADDRESS, loopback

    with loopback():
        yield ADDRESS


@pytest.fixture
def rendered_camera(tmp_path, loopback):
    """Makes a camera that renders a rig's plant, `rendered_camera(rig, world=…)`; one at a time."""
    from bench.camera import RenderedCamera

    made = []

    def make(simulated, **options):
        camera = RenderedCamera(tmp_path / f"camera{len(made)}", edges=simulated.edges_path, **options)
        made.append(camera)
        camera.start()
        return camera

    yield make
    for camera in made:
        camera.close()


@pytest.fixture
def whole_bench(tmp_path):
    """Waits until `make bench` may use the address; returns an environment with its own folder."""
    from bench.camera import loopback

    with loopback():
        pass
    return {**os.environ, "JAXSCAN_BENCH": str(tmp_path / "bench")}
