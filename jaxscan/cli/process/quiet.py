"""Prepares the process for other libraries: standard files, their messages, and their caches."""

import contextlib
import os
import sys
from pathlib import Path


def open_standard_files() -> None:
    """Open the standard files that the caller has closed, and let them print every character in some way."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # The next file that is opened would take its place, and messages would go into it.
            os.open(os.devnull, os.O_RDWR)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def hush_libraries() -> None:
    """Before they are loaded: let libraries not say what is answered anyway."""
    # An image that OpenCV cannot decode is an error of ours, with the file's name.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    # XLA's and absl's notes on their own work; errors are shown.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    os.environ.setdefault("GLOG_minloglevel", "2")


def cache_folder() -> Path | None:
    """The folder for what is kept from run to run, made if needed; None where there is no home, or it is read-only."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxscan"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        # RuntimeError: a user without an entry in the list of users, and without HOME.
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def keep_compiled_code() -> None:
    """Let JAX keep compiled code on the disk: it compiles once per machine, not once per run."""
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    cache = cache_folder()
    if cache is None:
        return
    compiled = cache / "compiled"
    with contextlib.suppress(OSError):
        # Those of a process that was killed between opening and writing; JAX would never replace them.
        for entry in os.scandir(compiled):
            if entry.stat().st_size == 0:
                os.unlink(entry.path)
    # Imported here, so that `--help` does not load JAX.
    import jax

    jax.config.update("jax_compilation_cache_dir", str(compiled))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
