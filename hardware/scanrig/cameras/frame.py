"""The interface of every camera, and its frames."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from jaxtyping import UInt8

from scanrig.cameras.settings import CameraSettings, TriggerMode


Features = dict[str, float | int | str]
"""A camera's settings, read back from it: "width", "height" [px], "pixel_format", "exposure_s", "gain_db", "trigger",
and further ones of its kind. Settings that a camera cannot read back are absent."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame, with its number and times."""

    image: UInt8[np.ndarray, "rows columns *three"]
    """uint8 [rows, columns], or RGB [rows, columns, 3]; owns its memory."""
    number: int
    """The camera's count of frames, unwrapped; −1: unknown. A gap means lost frames."""
    camera_s: float | None
    """The camera's own time stamp [s], of unknown origin; None: it has none."""
    host_s: float
    """Monotonic time of arrival [s]."""
    complete: bool
    """Whether the whole image arrived; missing parts are zero or older."""
    note: str = ""
    """A remark for the journal."""


@dataclass(frozen=True)
class CameraIdentity:
    """Identifies a camera: a sweep can be resumed only with the same one."""

    kind: str
    model: str
    serial: str

    def __str__(self) -> str:
        return " ".join(part for part in (self.kind, self.model, self.serial) if part)


class Camera(Protocol):
    """An open camera that is set up. Used from one thread; `close` may be called twice."""

    @property
    def identity(self) -> CameraIdentity:
        """Kind, model and serial number, as the device reports them."""

    @property
    def trigger_mode(self) -> TriggerMode:
        """How its exposures are triggered."""

    def features(self) -> Features:
        """Its settings, read back from the device.

        Raises:
            CameraLost: If it does not answer.
        """

    def counts(self) -> dict[str, int]:
        """Counts since opening: "frames" delivered, of these "incomplete"; "missing" by their numbers; "dropped"."""

    def start(self) -> None:
        """Start the acquisition; no effect if it runs.

        Raises:
            CameraError: If it cannot.
        """

    def drop(self) -> int:
        """Discard waiting frames, and of a free-running camera also those exposed before this call.

        Returns:
            Number of waiting frames.
        """

    def next(self, timeout_s: float) -> Frame:
        """The next frame in the order of exposure.

        Raises:
            CameraTimeout: If none came within `timeout_s`.
            CameraLost: If the camera is gone; `reopen` may recover it.
        """

    def trigger(self) -> None:
        """Expose one frame (trigger mode "software").

        Raises:
            CameraError: In another mode.
            CameraLost: If the camera is gone.
        """

    def reopen(self) -> None:
        """Open the camera again, apply the settings, check that it is the same one, and `start` it if it was started.

        Raises:
            CameraLost: If it is not found (yet).
            CameraError: If it is another camera, or does not take a setting.
        """

    def adopt(self, settings: CameraSettings) -> None:
        """Take other settings of the same camera from now on: `reopen` with them.

        Raises:
            CameraLost: If it is not found (yet).
            CameraError: If it does not take a setting.
        """

    def close(self) -> None:
        """Close the camera."""

    def __enter__(self) -> "Camera": ...

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class ClosedAtExit(ABC):
    """A camera that `with` closes."""

    @abstractmethod
    def close(self) -> None:
        """Close the camera."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
