"""Calibrations on disk."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.calibration.calibration import (
        calibration_digest,
        calibration_notes,
        check_calibration_path,
        load_calibration,
        load_parts,
        load_scanner,
        save_calibration,
    )
    from jaxscan.files.calibration.exports import CameraFormat, check_camera_path, export_camera
    from jaxscan.files.calibration.imports import ReadCamera, load_camera, read_camera
    from jaxscan.files.calibration.observations import observations_path
    from jaxscan.files.calibration.quality import finite, quality_table
    from jaxscan.files.calibration.settings import stored_settings
else:
    load_on_use(__name__)
