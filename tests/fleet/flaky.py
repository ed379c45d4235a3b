"""A file system behind fsspec that fails one read in twenty, and what a worker does that reads from it."""

import random

import fsspec
from fsspec.implementations.local import LocalFileSystem

from jaxscan.fleet.batch import do_order


ONE_IN = 20
SEED = 20


class FlakyFileSystem(LocalFileSystem):
    """The disk, with a network that loses answers."""

    protocol = "flaky"
    chance = random.Random(SEED)
    failed = 0

    def cat_file(self, path, start=None, end=None, **options):
        if self.chance.randrange(ONE_IN) == 0:
            FlakyFileSystem.failed += 1
            raise ConnectionResetError("the answer was lost")
        return super().cat_file(path, start=start, end=end, **options)


fsspec.register_implementation("flaky", FlakyFileSystem, clobber=True)


def do_flaky_order(text):
    """`do_order` in a process that knows the file system."""
    return do_order(text)
