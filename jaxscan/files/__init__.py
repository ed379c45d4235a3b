"""Everything on disk: captures (`capture` reads, `recording` writes), calibrations, clouds, and `disk` below them."""

from jaxscan.files.calibration import load_calibration as load_calibration
from jaxscan.files.calibration import load_scanner as load_scanner
from jaxscan.files.calibration import save_calibration as save_calibration
from jaxscan.files.capture import Capture as Capture
from jaxscan.files.capture import CaptureHeader as CaptureHeader
from jaxscan.files.capture import open_capture as open_capture
from jaxscan.files.clouds import load_cloud as load_cloud
from jaxscan.files.clouds import save_cloud as save_cloud
from jaxscan.files.disk import load_toml as load_toml
from jaxscan.files.recording import CaptureWriter as CaptureWriter
from jaxscan.files.recording import create_capture as create_capture
from jaxscan.files.recording import resume_capture as resume_capture
