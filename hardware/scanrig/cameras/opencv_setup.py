"""Sets up a camera through OpenCV, and reads its settings back."""

import cv2

from scanrig.cameras.frame import Features
from scanrig.cameras.settings import CameraSettings
from scanrig.errors import CameraError


_MANUAL = 1.0
"""V4L2_EXPOSURE_MANUAL."""
_PER_S = 1e4
"""V4L2's unit of exposure is 100 µs."""
_DRIVER = "V4L2"
"""The backend whose properties are known; for others their meaning differs from camera to camera."""


def apply_settings(capture: cv2.VideoCapture, settings: CameraSettings, *, name: str) -> Features:
    """Apply the settings that the backend supports, and switch automatic functions off.

    Returns:
        The features that the camera must report then.

    Raises:
        CameraError: With the property that cannot be set.
    """
    if capture.getBackendName() != _DRIVER:
        return {"width": settings.width, "height": settings.height}
    # The size first, since it may reset the rest. One buffer, if the driver supports that.
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, settings.width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.height)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    # Cameras without these functions refuse, which is fine; functions that stay on show up in the comparison.
    capture.set(cv2.CAP_PROP_AUTO_WB, 0)
    capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)
    if not capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL):
        raise CameraError(f"{name}: auto_exposure: cannot be switched off.")
    if not capture.set(cv2.CAP_PROP_EXPOSURE, round(_PER_S * settings.exposure_ms * 1e-3)):
        raise CameraError(f"{name}: exposure_ms: cannot be set.")
    capture.set(cv2.CAP_PROP_GAIN, settings.gain_db)
    return {
        "width": settings.width,
        "height": settings.height,
        "exposure_s": settings.exposure_ms * 1e-3,
        "gain_db": settings.gain_db,
        "auto_exposure": _MANUAL,
        "auto_white_balance": 0.0,
        "autofocus": 0.0,
    }


def read_features(capture: cv2.VideoCapture, settings: CameraSettings) -> Features:
    """The camera's settings as the backend reports them; settings that it cannot report are absent."""
    features: Features = {
        "width": int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
        "height": int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        "pixel_format": settings.pixel_format,
        "trigger": "free",
        "backend": capture.getBackendName(),
    }
    if features["backend"] != _DRIVER:
        return features
    features["exposure_s"] = capture.get(cv2.CAP_PROP_EXPOSURE) / _PER_S
    features["auto_exposure"] = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
    optional = {
        "gain_db": cv2.CAP_PROP_GAIN,
        "auto_white_balance": cv2.CAP_PROP_AUTO_WB,
        "autofocus": cv2.CAP_PROP_AUTOFOCUS,
    }
    # A camera without one reports −1.
    features |= {key: value for key, prop in optional.items() if (value := capture.get(prop)) >= 0}
    return features


def silent(backend: str) -> str:
    """The note for frames whose backend cannot report exposure and gain; "" if it can."""
    return "" if backend == _DRIVER else f"exposure and gain are not known: {backend} does not report them"
