"""What a camera is to the rest of the rig: frames, and the few calls that every kind has."""

from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

import numpy as np
from jaxtyping import UInt8

from scanrig.cameras.settings import TriggerMode


Features = dict[str, float | int | str]
"""What a camera is set to, read back from it: "width", "height" [px], "pixel_format", "exposure_s", "gain_db",
"trigger", and what else a kind has. Keys that a camera cannot read back are absent."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture and what is known of how it came."""

    image: UInt8[np.ndarray, "rows columns *three"]
    """uint8 [rows, columns], or RGB [rows, columns, 3]; memory of its own."""
    number: int
    """The camera's count of frames, without wraps; −1: unknown. A gap is a lost frame."""
    camera_s: float | None
    """The camera's own time stamp [s], of no known origin; None: it has none."""
    host_s: float
    """Monotonic time of arrival [s]."""
    complete: bool
    """Whether every part of the image arrived; what is missing is zero or older."""
    note: str = ""
    """What there is to say about it, for the journal."""


@dataclass(frozen=True)
class CameraIdentity:
    """Which camera it is: a sweep that is resumed needs the same."""

    kind: str
    model: str
    serial: str

    def __str__(self) -> str:
        return " ".join(part for part in (self.kind, self.model, self.serial) if part)


class Camera(Protocol):
    """A camera that is open and set up. Used from one thread; `close` may be called twice."""

    @property
    def identity(self) -> CameraIdentity:
        """Kind, model and serial number, as the device says."""

    @property
    def trigger_mode(self) -> TriggerMode:
        """What makes it expose."""

    def features(self) -> Features:
        """What it is set to, read back from the device.

        Raises:
            CameraLost: If it does not answer.
        """

    def counts(self) -> dict[str, int]:
        """Since it was opened: "frames" delivered, of these "incomplete"; "missing" by their numbers; "dropped"."""

    def start(self) -> None:
        """Let frames come; without effect if they do.

        Raises:
            CameraError: If it cannot.
        """

    def drop(self) -> int:
        """Throw away what waits; of a free-running camera also what was exposed before this call.

        Returns:
            Frames that were waiting.
        """

    def next(self, timeout_s: float) -> Frame:
        """The next frame in the order of exposure.

        Raises:
            CameraTimeout: If none came within `timeout_s`.
            CameraLost: If the camera is gone; `reopen` may bring it back.
        """

    def trigger(self) -> None:
        """Expose one frame (trigger mode "software").

        Raises:
            CameraError: In another mode.
            CameraLost: If the camera is gone.
        """

    def reopen(self) -> None:
        """Open it anew, set everything, and compare with what it was: then `start` as before.

        Raises:
            CameraLost: If it is not there (yet).
            CameraError: If it is another camera, or does not take a setting.
        """

    def close(self) -> None:
        """Let go of it."""

    def __enter__(self) -> "Camera": ...

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None: ...
