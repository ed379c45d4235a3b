"""Processes of a Dask cluster on loopback, as a user starts them."""

import contextlib
import os
import re
import subprocess
import sys
import threading


@contextlib.contextmanager
def scheduler():
    """A scheduler; yields its process and its address."""
    words = [
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
    ]
    with _started(words, r"Scheduler at:\s+(tcp://\S+)") as (process, address):
        yield process, address


@contextlib.contextmanager
def worker(address):
    """A worker of one thread; yields its process."""
    words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]
    words += ["--no-nanny", "--host", "127.0.0.1", "--memory-limit", "4GiB"]
    with _started(words, r"(Registered to):") as (process, _):
        yield process


@contextlib.contextmanager
def _started(words, ready):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path]), "NO_COLOR": "1"}
    # What Dask's own files of settings say on this machine is not part of the test.
    environment["DASK_CONFIG"] = os.devnull
    found = None
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment)
    try:
        found = next(filter(None, (re.search(ready, line) for line in process.stderr)), None)
        assert found, "it ended before it was ready"
        # A pipe that nobody reads would stop it.
        drain = threading.Thread(target=process.stderr.read)
        drain.start()
        yield process, found[1]
    finally:
        process.kill()
        process.wait()
        if found:
            drain.join()
        process.stderr.close()
