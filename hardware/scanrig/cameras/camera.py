"""What every camera is: its settings and features, its frames with their numbers, and the interface."""

import functools
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Literal, Self, cast

import numpy as np
import pydantic
from jaxtyping import UInt8, UInt16

from jaxscan.files.capture import CameraTable
from jaxscan.files.disk import ImageSize, Integer, Number
from jaxscan.geometry.scanner import Up
from jaxscan.stripes import DEEP_FORMATS, PIXEL_FORMATS, PixelFormat, Response, known_response, to_8_bits
from scanrig.errors import CameraError


CameraKind = Literal["aravis", "opencv", "simulated"]
TriggerMode = Literal["hardware", "software", "free"]


def _known_format(pixel_format: str) -> str:
    if pixel_format in PIXEL_FORMATS or pixel_format in DEEP_FORMATS:
        return pixel_format
    raise ValueError(f'found "{pixel_format[:60]}", expected one of {", ".join((*PIXEL_FORMATS, *DEEP_FORMATS))}')


class CameraSettings(ImageSize):
    """A camera and its settings; settings that are not listed here are left unchanged."""

    kind: CameraKind
    """"aravis" (GigE Vision and USB3 Vision), "opencv" (UVC), or "simulated"."""
    id: Annotated[str, pydantic.Field(max_length=1024)] = ""
    """Aravis: device id, serial number or address, "" for the only camera. OpenCV: index, path or URL."""
    pixel_format: Annotated[str, pydantic.AfterValidator(_known_format)] = "mono8"
    """How the camera gives a frame: one of `PIXEL_FORMATS`, or of `DEEP_FORMATS`, such as "mono12"."""
    response: Annotated[Response, pydantic.AfterValidator(known_response)] = "linear"
    up: Up = "-v"
    exposure_ms: Annotated[Number, pydantic.Field(gt=0, le=10_000)] = 10.0
    gain_db: Annotated[Number, pydantic.Field(ge=-100, le=100)] = 0.0
    """Gain of the camera's amplifier [dB], or in the camera's own unit."""
    trigger: TriggerMode = "hardware"
    """"hardware" (a wire), "software" (a command per frame), or "free" (free-running)."""
    trigger_source: Annotated[str, pydantic.Field(min_length=1, max_length=64, pattern=r"^[\x21-\x7e]+$")] = "Line1"
    """GenICam's name of the input of the trigger wire."""
    packet_size: Annotated[Integer, pydantic.Field(ge=200, le=65535)] | None = None
    """Bytes per stream packet (GigE Vision); None: the camera's own value."""
    flush_frames: Annotated[Integer, pydantic.Field(ge=0, le=100)] = 2
    """Free-running cameras: least number of frames that are discarded before one counts as new."""

    @pydantic.model_validator(mode="after")
    def _meaningful(self) -> "CameraSettings":
        if self.kind == "opencv" and self.trigger != "free":
            raise ValueError(f'trigger: found "{self.trigger}", but a camera of kind "opencv" can only be "free"')
        if self.kind == "opencv" and self.pixel_format not in ("mono8", "rgb8"):
            raise ValueError(f'pixel_format: found "{self.pixel_format}", but kind "opencv" gives "mono8" or "rgb8"')
        if self.bits > 8 and self.response != "linear":
            raise ValueError(f'response: found "{self.response}", but frames of {self.bits} bits are "linear"')
        return self

    @property
    def layout(self) -> PixelFormat:
        """How the pixels of a frame lie, whatever its bits: the pixel format of captures, and of `Frame.shown`."""
        return DEEP_FORMATS[self.pixel_format][0] if self.bits > 8 else cast(PixelFormat, self.pixel_format)

    @property
    def bits(self) -> int:
        """Bits of a sample."""
        return DEEP_FORMATS[self.pixel_format][1] if self.pixel_format in DEEP_FORMATS else 8

    @property
    def table(self) -> CameraTable:
        """The camera as in a capture's header."""
        return CameraTable(
            width=self.width,
            height=self.height,
            pixel_format=self.layout,
            response=self.response,
            up=self.up,
            bits=cast(Literal[10, 12, 14, 16], self.bits) if self.bits > 8 else None,
        )


Features = dict[str, float | int | str]
"""A camera's settings, read back from it: "width", "height" [px], "pixel_format", "exposure_s", "gain_db", "trigger",
and further ones of its kind. Settings that a camera cannot read back are absent."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame and its number."""

    image: UInt8[np.ndarray, "rows columns *three"] | UInt16[np.ndarray, "rows columns"]
    """uint8 [rows, columns], or RGB [rows, columns, 3]; uint16 of more than 8 bits; owns its memory."""
    number: int
    """The camera's count of frames, unwrapped; −1: unknown. A gap means lost frames."""
    complete: bool
    """Whether the whole image arrived; missing parts are zero or older."""
    note: str = ""
    bits: int = 8

    @functools.cached_property
    def shown(self) -> UInt8[np.ndarray, "rows columns *three"]:
        """The image in 8 bits, for pages, and for all that need not measure finer."""
        return to_8_bits(self.image, self.bits) if self.bits > 8 else self.image


@dataclass(frozen=True)
class CameraIdentity:
    """Identifies a camera: a sweep can be resumed only with the same one."""

    kind: str
    model: str
    serial: str

    def __str__(self) -> str:
        return " ".join(part for part in (self.kind, self.model, self.serial) if part)


class Camera(ABC):
    """An open camera that is set up. Used from one thread; `close`, which `with` calls, may be called twice.

    Its methods raise CameraLost if the camera is gone; `reopen` may recover it.
    """

    settings: CameraSettings
    identity: CameraIdentity

    @property
    def trigger_mode(self) -> TriggerMode:
        """How its exposures are triggered."""
        return self.settings.trigger

    @abstractmethod
    def features(self) -> Features:
        """Its settings, read back from the device."""

    @abstractmethod
    def start(self) -> None:
        """Start the acquisition; no effect if it runs. Raises CameraError if it cannot."""

    @abstractmethod
    def drop(self) -> int:
        """Discard waiting frames, and of a free-running camera also those exposed before; returns how many waited."""

    @abstractmethod
    def next(self, timeout_s: float) -> Frame:
        """The next frame in the order of exposure. Raises CameraTimeout if none came in time."""

    @abstractmethod
    def trigger(self) -> None:
        """Expose one frame. Raises CameraError in another trigger mode than "software"."""

    @abstractmethod
    def reopen(self) -> None:
        """Open the camera again, apply the settings, check that it is the same one, and `start` it if it was started.

        Raises:
            CameraLost: If it is not found (yet).
            CameraError: If it is another camera, or does not take a setting.
        """

    def adopt(self, settings: CameraSettings) -> None:
        """Take other settings of the same camera from now on: `reopen` with them, with its errors."""
        self.settings = settings
        self.reopen()

    @abstractmethod
    def close(self) -> None:
        """Close the camera."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


_EXPOSURE_SHARE = 0.02
_EXPOSURE_S = 50e-6
"""An exposure is a whole number of line times of the sensor, tens of microseconds each."""
_GAIN_DB = 0.2
"""Amplifiers have steps of about a tenth of a decibel."""


def wanted(settings: CameraSettings) -> Features:
    """The features that a camera with these settings must report."""
    return {
        "width": settings.width,
        "height": settings.height,
        "pixel_format": settings.pixel_format,
        "exposure_s": settings.exposure_ms * 1e-3,
        "gain_db": settings.gain_db,
        "trigger": settings.trigger,
    }


def differences(found: Features, expected: Features) -> list[str]:
    """Reported features that differ from the expected ones: "name: found ..., expected ..."."""
    return [
        f"{name}: found {_show(found[name])}, expected {_show(value)}"
        for name, value in expected.items()
        if name in found and not _same(name, found[name], value)
    ]


def require(found: Features, expected: Features, *, name: str) -> None:
    """Check that a camera took its settings. Raises CameraError with all differences, and the remedy."""
    if wrong := differences(found, expected):
        raise CameraError(f"{name}: did not take its settings: {'; '.join(wrong)}. Set supported values in [camera].")


def require_same(camera: Camera, expected: Features) -> None:
    """Check that a camera's settings are those of the beginning. Raises CameraError with all differences."""
    if wrong := differences(camera.features(), expected):
        raise CameraError(
            f"{camera.identity}: is not set as it was when the capture began: {'; '.join(wrong)}. "
            "Restore these settings, or begin a new capture."
        )


def _same(name: str, found: float | int | str, expected: float | int | str) -> bool:
    if isinstance(found, str) or isinstance(expected, str):
        return found == expected
    if name == "exposure_s":
        return math.isclose(found, expected, rel_tol=_EXPOSURE_SHARE, abs_tol=_EXPOSURE_S)
    if name == "gain_db":
        return math.isclose(found, expected, rel_tol=0.0, abs_tol=_GAIN_DB)
    return math.isclose(found, expected, rel_tol=1e-6)


def _show(value: float | int | str) -> str:
    return f'"{value:.60}"' if isinstance(value, str) else f"{value:g}"
