"""Everything on disk: captures (`capture` reads, `recording` writes), calibrations, clouds, and `disk` below them."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.calibration import load_calibration, load_scanner, save_calibration, save_scanner
    from jaxscan.files.capture import Capture, CaptureHeader, load_board, open_capture
    from jaxscan.files.clouds import load_cloud, save_cloud, save_clouds
    from jaxscan.files.disk import load_toml
    from jaxscan.files.recording import CaptureWriter, create_capture, resume_capture
else:
    load_on_use(__name__)
