"""From settings to an open camera; only the kind that is asked for is loaded."""

from scanrig.cameras.frame import Camera
from scanrig.cameras.settings import CameraSettings


def open_camera(settings: CameraSettings) -> Camera:
    """Open a camera, set it up, and see that it took the settings.

    Raises:
        CameraLost: If it is not there.
        CameraError: If several may be meant, it is taken, or does not take a setting.
        DependencyError: If the library of its kind is not installed.
    """
    match settings.kind:
        case "aravis":
            from scanrig.cameras.aravis import AravisCamera

            return AravisCamera(settings)
        case "opencv":
            from scanrig.cameras.opencv import OpenCVCamera

            return OpenCVCamera(settings)
        case "folder":
            from scanrig.cameras.folder import FolderCamera

            return FolderCamera(settings)
        case "simulated":
            from scanrig.cameras.simulated import open_simulated

            return open_simulated(settings)


def list_cameras() -> list[str]:
    """The cameras that are found: one line each, kind, id and name; what could not be looked for says so."""
    from scanrig.cameras.aravis import found_by_aravis
    from scanrig.cameras.opencv import found_by_opencv

    return [*found_by_aravis(), *found_by_opencv()]
