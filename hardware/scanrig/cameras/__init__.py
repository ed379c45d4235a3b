"""Cameras with one interface: GenICam through Aravis, UVC through OpenCV, and simulated ones.

Only the module of the camera that is opened is loaded.
"""

from collections.abc import Callable

from scanrig.cameras.camera import Camera, CameraIdentity, CameraSettings, Features, Frame, require_same


def open_camera(settings: CameraSettings, say: Callable[[str], None] = lambda sentence: None) -> Camera:
    """Open a camera, set it up, and check that it took the settings.

    Args:
        say: Called with a sentence for people before a long wait: until another program has lost control of it.

    Raises:
        CameraLost: If it is not found.
        CameraError: If several cameras fit, it is in use, or it does not take a setting.
        DependencyError: If the library of its kind is not installed.
    """
    match settings.kind:
        case "aravis":
            from scanrig.cameras.aravis import AravisCamera

            return AravisCamera(settings, say)
        case "opencv":
            from scanrig.cameras.opencv import OpenCVCamera

            return OpenCVCamera(settings)
        case "simulated":
            from scanrig.cameras.simulated import SimulatedCamera

            return SimulatedCamera(settings)


def list_cameras() -> list[str]:
    """One line for each camera found, with kind, id and name; and one for each library that is missing."""
    from scanrig.cameras.aravis import found_by_aravis
    from scanrig.cameras.opencv import found_by_opencv

    return [*found_by_aravis(), *found_by_opencv()]
