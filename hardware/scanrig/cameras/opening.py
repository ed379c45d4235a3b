"""Opens the camera of a configuration; only the module of its kind is loaded."""

from collections.abc import Callable

from scanrig.cameras.camera import Camera, CameraSettings, Features, require_same
from scanrig.clock import Clock
from scanrig.errors import CameraError, CameraLost


_LONGEST_PAUSE_S = 5.0


def open_camera(settings: CameraSettings, say: Callable[[str], None] = lambda sentence: None) -> Camera:
    """Open a camera, set it up, and check that it took the settings.

    Args:
        settings: Kind of camera, and its settings.
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
        case "folder":
            from scanrig.cameras.folder import FolderCamera

            return FolderCamera(settings)
        case "simulated":
            from scanrig.cameras.simulated import open_simulated

            return open_simulated(settings)


def list_cameras() -> list[str]:
    """One line for each camera found, with kind, id and name; and one for each library that is missing."""
    from scanrig.cameras.aravis import found_by_aravis
    from scanrig.cameras.opencv import found_by_opencv

    return [*found_by_aravis(), *found_by_opencv()]


def reopen_camera(camera: Camera, expected: Features, problem: Exception, clock: Clock, *, tries: int) -> int:
    """Open a lost camera again, ever more patiently, and check that its settings are the expected ones.

    Returns:
        The number of attempts.

    Raises:
        CameraError: If it did not come back, from `problem`; or if its settings differ.
    """
    last = problem
    for attempt in range(tries):
        clock.sleep(min(0.25 * 2**attempt, _LONGEST_PAUSE_S) if attempt else 0.0)
        try:
            camera.reopen()
            camera.start()
            require_same(camera, expected)
        except CameraLost as again:
            last = again
            continue
        return attempt + 1
    raise CameraError(f"{camera.identity} did not come back in {tries} tries: {last}") from problem
