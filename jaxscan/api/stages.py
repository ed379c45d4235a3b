"""One progress over stages of different cost, so that the time that is left follows from what is done."""

from collections.abc import Callable, Sequence
from typing import NamedTuple


Tell = Callable[[int, int], None]
"""Called with (work done, work in all)."""
_PARTS = 1000
"""Parts of the unit of stages, in which work is reported."""


class Stage(NamedTuple):
    """What a stage takes, in any unit that all stages share; here seconds of one processor that was measured."""

    begins: float
    """Before its first part is done: compiling, above all."""
    lasts: float = 0.0
    """All its parts."""


class Stages:
    """Progress of stages, one after the other."""

    def __init__(self, progress: Tell | None, stages: Sequence[Stage]) -> None:
        """Begin the first stage; with None nothing is reported."""
        self._progress, self._stages = progress, stages
        sizes = [stage.begins + stage.lasts for stage in stages]
        self._before = [sum(sizes[:number]) for number in range(len(sizes) + 1)]

    def part(self, number: int) -> Tell | None:
        """Progress of one stage, by its own parts."""
        if self._progress is None:
            return None
        tell, (begins, lasts), before = self._progress, self._stages[number], self._before[number]

        def progress(done: int, total: int) -> None:
            share = done / max(total, 1)
            work = before + (begins + lasts * share if done > 0 else 0.0)
            tell(round(_PARTS * work), max(round(_PARTS * self._before[-1]), 1))

        return progress

    def done(self, number: int) -> None:
        """A stage without progress of its own is over."""
        if (tell := self.part(number)) is not None:
            tell(1, 1)


def megapixels(width: int, height: int, images: int) -> float:
    """Millions of pixels of so many images."""
    return 1e-6 * width * height * images
