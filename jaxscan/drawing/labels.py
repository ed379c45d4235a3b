"""Places for texts where they cover neither each other nor what is drawn."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from jaxscan.drawing.model import SMALL_MM, TEXT_MM, DimensionLine, Drawing, Text


MARGIN_MM = 0.5


class Obstacles:
    """What texts must not cover: convex polygons and stretches of lines."""

    def __init__(self, paper_m: float) -> None:
        self.paper_m = paper_m
        self._shapes: list[np.ndarray] = []

    @staticmethod
    def of(drawing: Drawing) -> "Obstacles":
        """The lines and texts of a drawing."""
        made = Obstacles(drawing.sheet.paper_m)
        for line in drawing.lines:
            made.add_line(line.points)
        for text in drawing.texts:
            made.add_text(text)
        return made

    def add_line(self, points: np.ndarray) -> None:
        """A line through points [n, 2], m."""
        self._shapes += [points[i : i + 2] for i in range(len(points) - 1)]

    def add_text(self, text: Text) -> None:
        """A text at its place."""
        self._shapes.append(text.box())

    def are_clear_of(self, box: np.ndarray) -> bool:
        """Whether a convex polygon [n, 2] meets none of them."""
        low, high = box.min(0), box.max(0)
        return not any(
            (shape.min(0) < high).all() and (shape.max(0) > low).all() and _meet(box, shape) for shape in self._shapes
        )

    def placed(self, choices: Iterable[list[Text]], margin_mm: float = MARGIN_MM) -> list[Text] | None:
        """The first of several choices of texts that covers nothing; it is an obstacle then. None without one."""
        for texts in choices:
            if all(self.are_clear_of(text.box(margin_mm * self.paper_m)) for text in texts):
                for text in texts:
                    self.add_text(text)
                return texts
        return None

    def dimension(self, one: DimensionLine) -> DimensionLine:
        """A dimension with its texts where they cover nothing; in the middle where there is no such place.

        A line through the room is free for its own texts only, so it is added after they are placed.
        """
        paper = self.paper_m
        width = max(np.ptp(text.box()[:, 0]) for text in _level(one).texts(paper))
        middle = [0.0, *(share * one.length_m for share in (0.15, -0.15, 0.3, -0.3) if width < 0.4 * one.length_m)]
        beyond = [sign * (0.5 * (one.length_m + width) + 2.0 * paper) for sign in (1.0, -1.0)]
        # Words that are longer than the line go beside it, if no other dimension line continues there.
        steps = [*middle, *beyond] if width < one.length_m else [*beyond, *middle]
        row = (TEXT_MM + SMALL_MM + 2.5) * paper
        for up in (0.0, row, -row):
            for step in steps:
                choice = replace(one, shift=np.array([step, up]))
                texts = choice.texts(paper)
                alone = step not in beyond or self.are_clear_of(np.concatenate([text.box() for text in texts])[_AROUND])
                if alone and self.placed([list(texts)]) is not None:
                    self.add_line(one.ends)
                    return choice
        self.add_line(one.ends)
        return one


_AROUND = [4, 5, 2, 3]
"""Corners of the box around a distance and the text below it."""


def _level(one: DimensionLine) -> DimensionLine:
    """A dimension of the same words along x."""
    return replace(one, start=np.zeros(2), end=np.array([1.0, 0.0]), offset_m=0.0, shift=np.zeros(2))


def _meet(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two convex polygons, or stretches of lines, have a point in common: no line between them.

    Source: Ericson, Real-Time Collision Detection, section 5.2 (separating axes).
    """
    for one in (a, b):
        sides = np.roll(one, -1, 0) - one
        for normal in np.stack([-sides[:, 1], sides[:, 0]], 1):
            first, second = a @ normal, b @ normal
            if first.max() <= second.min() or second.max() <= first.min():
                return False
    return True
