"""Calibrations on disk."""

from jaxscan.files.calibration.calibration import calibration_digest as calibration_digest
from jaxscan.files.calibration.calibration import calibration_notes as calibration_notes
from jaxscan.files.calibration.calibration import check_calibration_path as check_calibration_path
from jaxscan.files.calibration.calibration import load_calibration as load_calibration
from jaxscan.files.calibration.calibration import load_scanner as load_scanner
from jaxscan.files.calibration.calibration import save_calibration as save_calibration
from jaxscan.files.calibration.exports import CameraFormat as CameraFormat
from jaxscan.files.calibration.exports import check_camera_path as check_camera_path
from jaxscan.files.calibration.exports import export_camera as export_camera
from jaxscan.files.calibration.quality import quality_table as quality_table
from jaxscan.files.calibration.settings import stored_settings as stored_settings
