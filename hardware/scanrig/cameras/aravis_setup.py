"""Finds a GenICam camera, sets it up, and reads its settings back."""

import contextlib
import ctypes
import ipaddress
from collections.abc import Callable

from jaxscan.stripes import PixelFormat
from scanrig.cameras.aravis_binding import ACCESS_CHECK, RANGE_CHECK, Aravis, AravisError, text
from scanrig.cameras.aravis_control import Say, take_control
from scanrig.cameras.frame import Features
from scanrig.cameras.settings import CameraSettings
from scanrig.errors import CameraError, CameraLost


PIXEL_FORMATS: dict[PixelFormat, tuple[str, ...]] = {
    "mono8": ("Mono8",),
    "rgb8": ("RGB8", "RGB8Packed"),
    "bayer_rggb8": ("BayerRG8",),
    "bayer_bggr8": ("BayerBG8",),
    "bayer_grbg8": ("BayerGR8",),
    "bayer_gbrg8": ("BayerGB8",),
}
"""GenICam's names of the pixel formats; the second name is used by older cameras."""

AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")
"""Automatic functions of a camera, which are switched off."""


def connect(aravis: Aravis, wanted: str, say: Say) -> int:
    """Connect to a camera, take control of it, and end an acquisition that a killed program left running.

    Args:
        aravis: The library.
        wanted: Device id, serial number or address; "" for the only camera.
        say: Called before waiting for another program to lose control.

    Raises:
        CameraLost: If it is not found.
        CameraError: If several cameras fit, or another program keeps control of it.
    """
    name = wanted if _is_address(wanted) else _found(aravis, wanted)
    try:
        camera = aravis.camera_new(name.encode())
    except AravisError as problem:
        raise CameraLost(f'camera "{name}": not found: {problem}; see that it has power and its cable.') from problem
    try:
        take_control(aravis, camera, name=f'camera "{name}"', say=say)
    except CameraError:
        aravis.unref(camera)
        raise
    # An acquisition that still runs would go on sending its frames to the program that began it.
    with contextlib.suppress(AravisError):
        aravis.camera_stop_acquisition(camera)
    return camera


def _is_address(name: str) -> bool:
    # An address needs no search; a search takes a second and does not cross routers.
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _found(aravis: Aravis, wanted: str) -> str:
    """Device id of the wanted camera."""
    aravis.update_device_list()
    kinds = "id", "physical_id", "serial_nbr", "address"
    every = [[text(getattr(aravis, f"get_device_{kind}")(k)) for kind in kinds] for k in range(aravis.get_n_devices())]
    meant = [names for names in every if wanted in names] if wanted else every
    listed = ", ".join(f'"{names[0]}" (serial number {names[2]}, {names[3]})' for names in every) or "none"
    if not meant:
        which = f'camera "{wanted}"' if wanted else "a camera"
        raise CameraLost(f"{which}: not found; found: {listed}. See that it has power and its cable.")
    if len(meant) > 1:
        raise CameraError(f"found {len(meant)} cameras: {listed}; give the `id` of one in [camera].")
    return meant[0][0]


def apply_settings(aravis: Aravis, camera: int, settings: CameraSettings, *, name: str) -> None:
    """Apply all settings, and switch automatic functions off.

    Raises:
        CameraError: With the setting that the camera refuses, and the reason.
    """
    aravis.camera_set_range_check_policy(camera, RANGE_CHECK)
    aravis.camera_set_access_check_policy(camera, ACCESS_CHECK)

    def set_text(feature: str, value: str) -> None:
        try:
            aravis.camera_set_string(camera, feature.encode(), value.encode())
        except AravisError as problem:
            raise CameraError(f'{name}: {feature}: does not take "{value}": {problem}') from problem

    def has(feature: str) -> bool:
        return bool(aravis.camera_is_feature_available(camera, feature.encode()))

    def attempt(failure: str, call: Callable[..., None], *arguments: float) -> None:
        try:
            call(camera, *arguments)
        except AravisError as problem:
            raise CameraError(f"{name}: {failure}: {problem}") from problem

    set_text("AcquisitionMode", "Continuous")
    _set_pixel_format(aravis, camera, settings, name)
    size = settings.width, settings.height
    attempt(f"does not take {size[0]} x {size[1]} px", aravis.camera_set_region, 0, 0, *size)
    for feature in AUTOMATICS:
        if has(feature):
            set_text(feature, "Off")
    attempt(
        f"does not take exposure_ms = {settings.exposure_ms:g}",
        aravis.camera_set_exposure_time,
        1000.0 * settings.exposure_ms,
    )
    if aravis.camera_is_gain_available(camera):
        attempt(f"does not take gain_db = {settings.gain_db:g}", aravis.camera_set_gain, settings.gain_db)
    attempt("its triggers cannot be switched off", aravis.camera_clear_triggers)
    if settings.trigger != "free":
        set_text("TriggerSelector", "FrameStart")
        set_text("TriggerSource", "Software" if settings.trigger == "software" else settings.trigger_source)
        if settings.trigger == "hardware" and has("TriggerActivation"):
            set_text("TriggerActivation", "RisingEdge")
        set_text("TriggerMode", "On")
    if settings.packet_size is not None and aravis.camera_is_gv_device(camera):
        attempt("does not take its packet_size", aravis.camera_gv_set_packet_size, settings.packet_size)


def _set_pixel_format(aravis: Aravis, camera: int, settings: CameraSettings, name: str) -> None:
    problems = []
    for known in PIXEL_FORMATS[settings.pixel_format]:
        try:
            aravis.camera_set_string(camera, b"PixelFormat", known.encode())
        except AravisError as problem:
            problems.append(str(problem))
        else:
            return
    raise CameraError(f'{name}: does not take pixel_format = "{settings.pixel_format}": {"; ".join(problems)}')


def read_features(aravis: Aravis, camera: int, settings: CameraSettings) -> Features:
    """The camera's settings, read back from it; settings that it cannot report are absent."""
    region = [ctypes.c_int() for _ in range(4)]
    aravis.camera_get_region(camera, *(ctypes.byref(one) for one in region))
    pixel_format = text(aravis.camera_get_string(camera, b"PixelFormat"))
    ours = [name for name, known in PIXEL_FORMATS.items() if pixel_format in known]
    features: Features = {
        "width": region[2].value,
        "height": region[3].value,
        "offset_x": region[0].value,
        "offset_y": region[1].value,
        "pixel_format": ours[0] if ours else pixel_format,
        "exposure_s": 1e-6 * aravis.camera_get_exposure_time(camera),
    }
    if aravis.camera_is_gain_available(camera):
        features["gain_db"] = float(aravis.camera_get_gain(camera))
    for feature in AUTOMATICS:
        if aravis.camera_is_feature_available(camera, feature.encode()):
            features[feature] = text(aravis.camera_get_string(camera, feature.encode()))
    features |= _trigger(aravis, camera, settings)
    if aravis.camera_is_gv_device(camera):
        features["packet_size"] = int(aravis.camera_gv_get_packet_size(camera))
    return features


def _trigger(aravis: Aravis, camera: int, settings: CameraSettings) -> Features:
    """Its trigger mode: "free", "software", or "hardware" if it listens to `trigger_source`."""
    if not aravis.camera_is_feature_available(camera, b"TriggerMode"):
        return {"trigger": "free"}
    aravis.camera_set_string(camera, b"TriggerSelector", b"FrameStart")
    if text(aravis.camera_get_string(camera, b"TriggerMode")) != "On":
        return {"trigger": "free"}
    source = text(aravis.camera_get_string(camera, b"TriggerSource"))
    known = {"Software": "software", settings.trigger_source: "hardware"}
    return {"trigger": known.get(source, source), "trigger_source": source}
