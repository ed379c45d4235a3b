"""Open3D, by which surfaces are closed, and against which experiments and tests compare."""

import ctypes
import glob
import os
from functools import cache
from types import ModuleType

from jaxscan.errors import DependencyError


_PACKAGES = "libusb-1.0-0 libegl1 libgl1 libx11-6 libgomp1 libudev1 libidn2-0"


@cache
def load_open3d() -> ModuleType:
    """The module open3d.

    Raises:
        DependencyError: If it or a system library it needs is missing.
    """
    try:
        import libusb_package

        # Open3D 0.20 is linked against libusb, which few systems have; the package brings one,
        # and it must be loaded first.
        for library in sorted(glob.glob(os.path.join(os.path.dirname(libusb_package.__file__), "libusb-1.0*"))):
            ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # The system may have libusb; if not, the next import says so.
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise DependencyError(
            f'Open3D does not load: {error}. Type pip install "jaxscan[poisson]" and, on Debian or Ubuntu, apt-get '
            f"install {_PACKAGES}"
        ) from error
    return open3d
