"""The files of a case in the making: copies of the corpus, some of them changed."""

import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from .archives import change_npz, change_shard
from .pictures import change_image
from .places import replace_place, strange_name
from .texts import change_journal, change_toml


IN, OUT, VICTIM = "in", "out", "victim.txt"
SECRET = "sk-secret-4711"
"""What the victim holds; no result may repeat it."""
VICTIM_PLACE = "JAXSCAN_FUZZ_VICTIM"
"""Variable with the path of the victim of a case."""


@dataclass
class Case:
    """A folder of inputs and a command."""

    kind: str
    words: list[str]
    outputs: set[str] = field(default_factory=set)
    """Names, below the folder of the case, that the command may write when it succeeds."""
    kept: set[str] = field(default_factory=set)
    """Names that it may write in any case: the cache of stripes."""
    cloud: str | None = None
    """The cloud that is compared with that of the unchanged files."""
    drive: Callable[[], list[str]] | None = None
    """In place of words: a part of the program that no verb reaches alone; it returns the faults that it saw."""
    needs_word: bool = False
    """Whether the change is one that must be refused, or said in a note."""
    allowed: frozenset[str] = frozenset()
    """What it may ask of the system: "network", "program"."""
    most_bytes: int | None = None
    """A full disk: no file may grow beyond this."""
    read_only: tuple[Path, ...] = ()
    """Folders that cannot be written while it runs."""


class Draft:
    """The files of a case in the making."""

    def __init__(self, rng: random.Random, corpus: Path, folder: Path) -> None:
        self.rng, self.corpus, self.folder = rng, corpus, folder
        (folder / IN).mkdir(parents=True)
        (folder / OUT).mkdir()
        os.environ[VICTIM_PLACE] = str(folder / VICTIM)
        (folder / VICTIM).write_text(f"{SECRET}\n")

    def take(self, name: str) -> Path:
        """A copy of a file or folder of the corpus."""
        source, target = self.corpus / name, self.folder / IN / name
        if source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copy(source, target)
        return target

    def change(self, path: Path, change: Callable[[random.Random, bytes], bytes]) -> None:
        """Replace a file by a changed one, or, now and then, by something that is no file."""
        if self.rng.random() < 0.08:
            replace_place(self.rng, path, self.folder / VICTIM)
            return
        path.write_bytes(change(self.rng, path.read_bytes()))

    def output(self, name: str) -> str:
        """Where a verb is to write; now and then a place that is hard to write to."""
        if self.rng.random() < 0.02:
            return str(self.folder / OUT / (strange_name(self.rng) + Path(name).suffix))
        return str(self.folder / OUT / name)


def changed_capture(draft: Draft, name: str) -> Path:
    rng, capture = draft.rng, draft.take(name)
    part = rng.choices(("journal", "header", "image", "place", "cache"), (40, 25, 25, 5, 5))[0]
    if part == "journal":
        draft.change(capture / "frames.jsonl", change_journal)
    elif part == "header":
        draft.change(capture / "capture.toml", change_toml)
    elif part == "image":
        images = sorted(one for side in ("on", "off") for one in (capture / side).iterdir())
        one = rng.choice(images)
        if name == "shards":
            draft.change(one, change_shard)
        elif rng.random() < 0.3:
            shutil.copy(rng.choice([other for other in images if other != one]), one)
        else:
            draft.change(one, change_image)
    elif part == "cache":
        shutil.copy(draft.corpus / "stripes.npz", capture / "stripes.npz")
        draft.change(capture / "stripes.npz", change_npz)
    else:
        replace_place(rng, rng.choice((capture / "on", capture / "off", capture)), draft.folder / VICTIM)
    return capture
