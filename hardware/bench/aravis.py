"""libaravis' fake GigE Vision camera, through ctypes: found, controlled and streamed from over UDP like a real one."""

import ctypes


LIBRARY = "libaravis-0.8.so.0"


def aravis_is_there() -> bool:
    """Whether the library is installed."""
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        return False
    return True
