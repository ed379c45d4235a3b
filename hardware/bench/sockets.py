"""Control sockets: one line of text there, one line back."""

import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.errors import BenchError


@contextmanager
def _short(path: Path) -> Iterator[str]:
    """A name of the socket that fits the 108 bytes of its address, however deep the folder is."""
    folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


class ControlClient:
    """A conversation with a control socket."""

    def __init__(self, path: Path, *, timeout_s: float = 20.0) -> None:
        """Connect to the socket at `path`.

        Raises:
            BenchError: If nobody listens there.
        """
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(timeout_s)
        try:
            with _short(path) as name:
                self._socket.connect(name)
        except OSError as problem:
            self._socket.close()
            raise BenchError(f"{path}: nobody answers there: {problem.strerror}. Is the bench running?") from problem
        self._rest = b""

    def ask(self, text: str) -> str:
        """Send one line, return the answer.

        Raises:
            BenchError: If none comes.
        """
        try:
            self._socket.sendall(text.encode() + b"\n")
            while b"\n" not in self._rest:
                more = self._socket.recv(4096)
                if not more:
                    raise BenchError(f"{self._path}: hung up after {text!r}.")
                self._rest += more
        except OSError as problem:
            raise BenchError(f"{self._path}: no answer to {text!r}: {problem}.") from problem
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode()

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


class ControlServer:
    """Answers at a socket, in threads of its own, until it is closed."""

    def __init__(self, path: Path, answer: Callable[[str], str]) -> None:
        """Listen at `path`, which is made; an old socket there is replaced.

        Args:
            answer: Called with each line; may be called from several threads.
        """
        path.unlink(missing_ok=True)
        self._path, self._answer = path, answer
        self._socket = socket.socket(socket.AF_UNIX)
        with _short(path) as name:
            self._socket.bind(name)
        self._socket.listen(4)
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Answer no more."""
        self._path.unlink(missing_ok=True)
        self._socket.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return  # Closed.
            threading.Thread(target=self._converse, args=(client,), daemon=True).start()

    def _converse(self, client: socket.socket) -> None:
        with client, client.makefile("rw") as text:
            for line in text:
                try:
                    answer = self._answer(line.strip())
                except BenchError as problem:
                    answer = f"error: {problem}"
                try:
                    text.write(answer + "\n")
                    text.flush()
                except OSError:
                    return  # Whoever asked does not wait for the answer.
