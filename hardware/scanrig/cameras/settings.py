"""The `[camera]` table of a rig's configuration: which camera, and its settings."""

from typing import Annotated, Literal

import pydantic

from jaxscan.files.disk import ImageSize, Integer, Number
from jaxscan.geometry.scanner import Up
from jaxscan.stripes import PixelFormat, Response, known_response


CameraKind = Literal["aravis", "opencv", "folder", "simulated"]
TriggerMode = Literal["hardware", "software", "free"]


class CameraSettings(ImageSize):
    """A camera and its settings; settings that are not listed here are left unchanged."""

    kind: CameraKind
    """"aravis" (GigE Vision and USB3 Vision), "opencv" (UVC), "folder" (plays images), or "simulated"."""
    id: Annotated[str, pydantic.Field(max_length=1024)] = ""
    """Aravis: device id, serial number or address, "" for the only camera. OpenCV: index, path or
    URL. Folder: its path. Simulated: a TOML file of a synthetic scene, or ""."""
    pixel_format: PixelFormat = "mono8"
    """How a frame is to be read."""
    response: Annotated[Response, pydantic.AfterValidator(known_response)] = "linear"
    """"linear", "srgb" or "gamma 2.2"."""
    up: Up = "-v"
    """Which direction of the image is up."""
    exposure_ms: Annotated[Number, pydantic.Field(gt=0, le=10_000)] = 10.0
    """Exposure time of a frame [ms]."""
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
        if self.kind == "folder" and not self.id:
            raise ValueError('id: found "", but kind "folder" needs the path of a folder')
        return self
