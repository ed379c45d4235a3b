"""Software of a cluster beside that of the caller: what differs is said with both versions, before any work."""

import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import distributed
import pytest

import jaxscan
from jaxscan import __version__
from jaxscan.errors import OptionError
from jaxscan.fleet import ClusterChoice, check_versions, open_cluster, package_digest
from jaxscan.fleet.clusters.checks import digest_below, versions_here


WORKER = """
import asyncio, sys
from jaxscan.fleet.clusters import checks
import distributed

checks.jaxscan.__version__ = "0.0.7"
checks.package_digest = lambda: "sha256:" + 64 * "e"

async def work():
    worker = await distributed.Worker(sys.argv[1], nthreads=1, host="127.0.0.1", memory_limit=0)
    await worker.finished()

asyncio.run(work())
"""
"""A process that works for a cluster with another version of the package."""


@pytest.mark.rig
def test_a_worker_with_another_jaxscan_is_refused_with_both_versions():
    with distributed.LocalCluster(
        n_workers=0, processes=False, host="127.0.0.1", protocol="tcp://", dashboard_address="127.0.0.1:0"
    ) as cluster:
        command = [sys.executable, "-c", WORKER, cluster.scheduler_address]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
            try:
                with pytest.raises(OptionError) as caught:
                    with open_cluster(ClusterChoice(address=cluster.scheduler_address)):
                        pytest.fail("opened")
            finally:
                process.kill()
    said = str(caught.value)
    here = package_digest().removeprefix("sha256:")[:12]
    assert "the cluster's worker tcp://127.0.0.1:" in said
    assert f"runs jaxscan 0.0.7 (code eeeeeeeeeeee), and here is {__version__} (code {here})" in said
    assert "\n" not in said


class Told:
    """Stands for a client of a cluster: what Dask says of its parts, and what our own function answers there."""

    def __init__(self, scheduler=None, dask=None, answer=None):
        here = versions_here()
        packages = {**here, "python": sys.version.split()[0]}
        self.asked = {
            "scheduler": {"packages": packages | (scheduler or {})},
            "workers": {"tcp://w:1": {"packages": packages | (dask or {})}},
        }
        self.answer = answer if isinstance(answer, Exception) else here | (answer or {})

    def get_versions(self, packages):
        return self.asked

    def run(self, function, on_error):
        assert function is versions_here and on_error == "return"
        return {"tcp://w:1": self.answer}


@pytest.mark.rig
def test_the_same_everywhere_is_silent():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_versions(Told())
        check_versions(Told(scheduler={"jax": None, "numpy": None}))  # It computes nothing.


HERE = versions_here()


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (
            Told(dask={"dask": "2020.1.0"}),
            f"the cluster's worker tcp://w:1 runs dask 2020.1.0, and here is {HERE['dask']}",
        ),
        (
            Told(scheduler={"distributed": "1.0"}),
            f"the cluster's scheduler runs distributed 1.0, and here is {HERE['distributed']}",
        ),
        (
            Told(scheduler={"python": "3.8.1.final.0"}),
            f"the cluster's scheduler runs Python 3.8, and here is {HERE['Python']}",
        ),
        (
            Told(answer={"Python": "3.99"}),
            f"the cluster's worker tcp://w:1 runs Python 3.99, and here is {HERE['Python']}",
        ),
        (Told(answer={"jaxscan": "9"}), f"runs jaxscan 9, and here is {HERE['jaxscan']}"),
        (
            Told(answer=ModuleNotFoundError("jaxscan")),
            "tcp://w:1 has no jaxscan that knows batches (ModuleNotFoundError)",
        ),
    ],
)
def test_a_difference_that_matters_is_one_line_with_both_versions(told, says):
    with pytest.raises(OptionError) as caught:
        check_versions(told)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("package", ["jax", "jaxlib", "numpy"])
def test_other_rounding_is_a_warning(package):
    with pytest.warns(RuntimeWarning, match=rf"tcp://w:1 computes with {package} 0\.1, and here is {HERE[package]}"):
        check_versions(Told(answer={package: "0.1"}))


def test_every_file_of_the_package_is_in_its_digest(tmp_path):
    source, copy = Path(jaxscan.__file__).parent, tmp_path / "copy"
    shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__", "data"))
    original = digest_below(copy)
    assert original.startswith("sha256:") and digest_below(copy) == original
    for file in (copy / "__init__.py", copy / "fleet" / "clusters" / "ssh.py", copy / "stripes" / "engine.py"):
        text = file.read_text()
        file.write_text(text + "#")
        assert digest_below(copy) != original
        file.write_text(text)
    # What was moved is another package too.
    (copy / "errors.py").rename(copy / "mistakes.py")
    assert digest_below(copy) != original
    assert package_digest() == digest_below(source)
