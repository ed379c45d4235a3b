"""A rig without hardware for every test that asks for one; without its tools such a test is skipped, by name."""

import os

import pytest


REQUIRED = bool(os.environ.get("JAXSCAN_REQUIRE_BENCH"))


def _refuse_or_skip(reason):
    if REQUIRED:
        raise pytest.UsageError(f"JAXSCAN_REQUIRE_BENCH is set, but {reason}")
    return pytest.mark.skip(reason=reason)


def missing_for_the_rig():
    """What the simulated rig lacks, as one line; "" if nothing."""
    from bench.build import missing_tools

    packages = missing_tools()
    return f"the simulated rig needs {', '.join(packages)}: type `make bench-deps`" if packages else ""


def missing_for_the_loopback():
    """What a camera on loopback lacks, as one line; "" if nothing."""
    from bench.camera import aravis_is_there

    return "" if aravis_is_there() else "a camera on loopback needs libaravis-0.8-0: type `make bench-deps`"


def missing_for_the_camera():
    """What the camera that renders lacks, as one line; "" if nothing."""
    from jaxscan.errors import DependencyError
    from jaxscan.simulation.scene.open3d import load_open3d

    try:
        load_open3d()
    except DependencyError as problem:
        return str(problem)
    return ""


NEEDS = {
    "rig": [missing_for_the_rig],
    "loopback": [missing_for_the_loopback],
    "rendered_camera": [missing_for_the_camera],
    "whole_bench": [missing_for_the_rig, missing_for_the_loopback, missing_for_the_camera],
}
"""Fixtures that need tools, and who says which are missing."""


def pytest_collection_modifyitems(items):
    """Skips by name what cannot run here; with JAXSCAN_REQUIRE_BENCH=1 that is an error instead."""
    for name, checks in NEEDS.items():
        wanting = [item for item in items if name in getattr(item, "fixturenames", ())]
        if wanting and (reason := next((said for check in checks if (said := check())), "")):
            mark = _refuse_or_skip(reason)
            for item in wanting:
                item.add_marker(mark)


@pytest.fixture
def rig(tmp_path):
    """Makes simulated rigs, `rig(speed=…, …)`, each in a folder of its own; all are switched off at the end."""
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
    """The one address at which a GigE Vision camera can be, 127.0.0.1, to itself: tests run side by side."""
    from bench.camera import ADDRESS, loopback

    with loopback():
        yield ADDRESS


@pytest.fixture
def rendered_camera(tmp_path, loopback):
    """Makes the camera that sees what a rig's plant shows, `rendered_camera(rig, world=…)`; one at a time."""
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
    """Waits until `make bench` may take the address; the environment that puts it into a folder of its own."""
    from bench.camera import loopback

    with loopback():
        pass
    return {**os.environ, "JAXSCAN_BENCH": str(tmp_path / "bench")}
