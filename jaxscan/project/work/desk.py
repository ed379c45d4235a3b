"""The desk of a step: its sources, fetched where they are remote, and a folder for the files it writes."""

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxscan.errors import CaptureError
from jaxscan.files.capture import Capture, open_capture
from jaxscan.files.disk import make_folder, partial_folder, refuse_links, reported
from jaxscan.files.remote import fetch_file, fetch_folder, is_remote
from jaxscan.project.steps import Step
from jaxscan.reconstruction import Progress


MOST_BYTES = 1 << 40
"""Of one capture that is fetched."""
_SHARE = 0.9
"""Of the free disk that fetched captures may take."""


@dataclass(frozen=True)
class Desk:
    """Where a step reads and writes."""

    step: Step
    output: Path
    """The folder of the products."""
    folder: Path
    """Where it writes: its files get their places when all are complete."""
    progress: Progress
    """Called with (done, in all)."""
    notes: list[str] = field(default_factory=list)
    """Remarks for the user, a sentence each."""
    owned: list[str] = field(default_factory=list)
    """Folders among the products that hold only files of this step: older ones are removed from them."""

    def capture(self, role: str = "capture") -> Capture:
        """A capture. Its stripes are kept among the products: nothing is written into its own folder.

        Raises:
            CaptureError: If it is none, or cannot be fetched.
        """
        address = self.step.sources[role]
        path, name = Path(address), Path(address).name
        kept = self.output / "stripes"
        if is_remote(address):
            # Stripes of a copy serve no other one.
            kept = self._fetched(role)
            path = kept / name
            make_folder(path, new=True)
            free = shutil.disk_usage(path).free
            fetch_folder(address, path, most_bytes=min(MOST_BYTES, int(_SHARE * free)))
        _make(self.output if kept.is_relative_to(self.output / "stripes") else self.folder, kept)
        capture = open_capture(path).keeping(kept / f"{self._name(role)}.npz")
        self.notes.extend(capture.notes)
        return capture

    def _name(self, role: str) -> str:
        """The name of a capture in the project: folders of two may be called alike."""
        if role.startswith("capture "):
            return role.removeprefix("capture ")
        return self.step.key.split("/")[-1 if self.step.kind == "station" else 1]

    def file(self, role: str) -> Path:
        """A file that a step before made, or that was given."""
        if role in self.step.products:
            path = self.output / self.step.products[role]
            with reported(f"{path}: cannot be read", error=CaptureError):
                refuse_links(self.output, path)
            return path
        address = self.step.sources[role]
        if not is_remote(address):
            return Path(address)
        path = self._fetched(role) / Path(address).name
        make_folder(path.parent, own=self.folder)
        if not path.exists():
            fetch_file(address, path, most_bytes=MOST_BYTES)
        return path

    def _fetched(self, role: str) -> Path:
        """A folder for what is fetched of one source: two may have one name."""
        return self.folder / "fetched" / str(list(self.step.sources).index(role))

    def target(self, number: int = 0) -> Path:
        """Where an output of the step is to be written."""
        return self.beside(self.step.outputs[number])

    def beside(self, output: str) -> Path:
        """Where a file is to be written that gets the place `output` among the products."""
        path = self.folder / "made" / output
        make_folder(path.parent, own=self.folder)
        return path

    def made(self) -> list[str]:
        """All that was written so far, by its place among the products."""
        made = self.folder / "made"
        return sorted(str(path.relative_to(made)) for path in made.rglob("*") if path.is_file())

    def setting(self, name: str) -> Any:
        """A setting of the step."""
        return self.step.settings[name]


@contextlib.contextmanager
def desk_of(step: Step, output: Path, progress: Progress) -> Iterator[Desk]:
    """A desk whose folder is removed at the end, and with a process that was killed by the next one.

    Raises:
        CaptureError: If the folder of the products cannot be written.
    """
    with contextlib.ExitStack() as stack:
        with reported(f"{output}: cannot be written", error=CaptureError):
            folder = stack.enter_context(partial_folder(output / "step"))
        yield Desk(step, output, folder, progress)


def publish(desk: Desk) -> None:
    """Give all that was written its place among the products; each file is there whole or not at all."""
    made = desk.made()
    for path in made:
        target = desk.output / path
        _make(desk.output, target.parent)
        desk.beside(path).replace(target)
    for folder in desk.owned:
        with reported(f"{desk.output / folder}: cannot be written", error=CaptureError):
            refuse_links(desk.output, desk.output / folder)
        for old in (desk.output / folder).iterdir():
            if str(old.relative_to(desk.output)) not in made and not old.is_dir():
                old.unlink()


def _make(own: Path, folder: Path) -> None:
    with reported(f"{folder}: cannot be written", error=CaptureError):
        make_folder(folder, own=own)
