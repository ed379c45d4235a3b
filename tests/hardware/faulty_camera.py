"""A simulated camera with every fault that a camera can have, which does not wait for frames."""

from dataclasses import replace
from typing import Literal

import numpy as np
from scanrig.cameras.camera import Features, Frame, require, wanted
from scanrig.cameras.simulated import SimulatedCamera
from scanrig.errors import CameraLost


Fault = Literal["missing", "duplicate", "incomplete", "stale", "swapped", "late", "lost"]
"""Faults of an exposure: its frame is not delivered; delivered twice; half delivered; replaced by the one before;
exchanged with the one after; delivered only with the one after; and: the camera is gone from here on."""


class FaultyCamera(SimulatedCamera):
    """It must be exposed before `next` is called."""

    patience_s = 0.0

    def __init__(self, *arguments, **options) -> None:
        super().__init__(*arguments, **options)
        self.faults: dict[int, Fault] = {}
        """By the number of the exposure, from 1."""
        self.reachable = True
        """Whether `reopen` finds it."""
        self.after_reopen: Features = {}
        """Features that it has after `reopen` regardless of its settings."""
        self._held: list[Frame] = []
        self._last: np.ndarray | None = None
        self._lost = False

    def reopen(self) -> None:
        if not self.reachable:
            raise CameraLost(f"{self.identity}: not found; check its power and cable.")
        self._held.clear()
        self._lost = False
        super().reopen()
        self.device |= self.after_reopen
        require(self.device, wanted(self.settings), name=str(self.identity))

    def _gone(self) -> str:
        return super()._gone() or ("gone (simulated)" if self._lost else "")

    def _arrive(self, image: np.ndarray) -> None:
        held, self._held = self._held, []
        frame = self._frame(image)
        match self.faults.get(self.exposures):
            case "missing":
                arriving = []
            case "duplicate":
                arriving = [frame, frame]
            case "incomplete":
                torn = image.copy()
                torn[len(torn) // 2 :] = 0
                arriving = [replace(self._frame(torn), complete=False, note="half of its packets are missing")]
            case "stale":
                arriving = [frame if self._last is None else self._frame(self._last)]
            case "swapped" | "late":
                self._held, arriving = [frame], []
            case "lost":
                self._lost, arriving = True, []
            case None:
                arriving = [frame]
        for waiting in held:
            if self.faults.get(waiting.number) == "late":
                self._queue.append(waiting)
            else:  # Swapped: the numbers are in order, the images are exchanged.
                self._queue.append(replace(self._frame(image), number=waiting.number))
                arriving = [self._frame(waiting.image)]
        self._queue.extend(arriving)
        self._last = image

    def _frame(self, image: np.ndarray) -> Frame:
        return Frame(image, self.exposures, complete=True, bits=self.settings.bits)
