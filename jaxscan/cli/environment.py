"""Prepares the process for other libraries: standard files, their messages, and their caches."""

import contextlib
import os
import stat
import sys
import tempfile
import warnings
from pathlib import Path


def open_standard_files() -> None:
    """Open the standard files that the caller has closed, and let them print every character in some way."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # Otherwise the next file that is opened would take its number, and messages would go into that file.
            os.open(os.devnull, os.O_RDWR)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def hush_libraries() -> None:
    """Before libraries are loaded: silence the messages that jaxscan answers itself, and the search for plugins."""
    # An image that OpenCV cannot decode is an error of ours, with the file's name.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # XLA's and absl's notes on their own work; errors are shown.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    os.environ.setdefault("GLOG_minloglevel", "2")
    # Looking for plugins, of which we have none, reads the description of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")


def choose_caches() -> None:
    """Before it is loaded: where there is no home to write to, Matplotlib keeps its files in `cache_folder` too."""
    cache = cache_folder()
    if cache is not None and cache != _home_cache():
        os.environ.setdefault("MPLCONFIGDIR", str(cache / "matplotlib"))


def one_thread_per_product() -> None:
    """Before it is loaded: NumPy multiplies small matrices in the calling thread.

    Views are shared out among the cores already; threads of its own then only wait for each other, and take seven times
    the processor's time.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def keep_compiled_code() -> None:
    """Let JAX keep compiled code on the disk: it compiles once per machine, not once per run."""
    cache = cache_folder()
    if os.environ.get("JAX_COMPILATION_CACHE_DIR") or cache is None:
        return
    compiled = cache / "compiled"
    try:
        compiled.mkdir(parents=True, exist_ok=True)
        # Empty files, left by a process that was killed before it wrote; JAX would never replace them.
        for entry in os.scandir(compiled):
            # Another process may remove it at the same time.
            with contextlib.suppress(OSError):
                if entry.is_file(follow_symlinks=False) and entry.stat().st_size == 0:
                    os.unlink(entry.path)
    except OSError:
        return
    # Small functions too: reading one back takes a third of the time of compiling it, and a few kilobytes.
    settings = {"jax_compilation_cache_dir": str(compiled), "jax_persistent_cache_min_compile_time_secs": 0.0}
    if "jax" in sys.modules:
        for name, value in settings.items():
            sys.modules["jax"].config.update(name, value)
    else:
        # JAX looks here when it is loaded; many verbs do not need it.
        os.environ.update({name.upper(): str(value) for name, value in settings.items()})
    # Code that cannot be read back is compiled again, and nothing else follows from that.
    warnings.filterwarnings("ignore", "Error reading persistent compilation cache entry")


def cache_folder() -> Path | None:
    """The folder for files that are kept from run to run: at home, else in the temporary folder; None without either.

    It may not exist yet.
    """
    home = _home_cache()
    return home if home is not None and _can_be_made(home) else _temporary_cache()


def _home_cache() -> Path | None:
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxscan"
    except RuntimeError:
        return None  # Without HOME, and without an entry in the list of users.


def _can_be_made(folder: Path) -> bool:
    """Whether a folder can be written, or be made below the first of its parents that exists."""
    # `Path.exists` raises where a folder above may not be looked into.
    while not os.path.exists(folder):
        folder = folder.parent
    return os.path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)


def _temporary_cache() -> Path | None:
    if os.name != "posix":
        return None
    try:
        folder = Path(tempfile.gettempdir(), f"jaxscan-{os.getuid()}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        status = os.lstat(folder)
    except OSError:
        return None
    # Compiled code is run when it is read back, so nobody else may have written it.
    private = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077
    return folder if private else None
