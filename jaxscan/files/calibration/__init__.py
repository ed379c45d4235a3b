"""Calibrations on disk."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.calibration.calibration import (
        calibration_digest,
        calibration_notes,
        check_calibration_path,
        finite,
        load_calibration,
        load_parts,
        load_scanner,
        observations_path,
        quality_table,
        save_calibration,
        save_scanner,
        stored_settings,
    )
    from jaxscan.files.calibration.cameras import (
        CameraFormat,
        ReadCamera,
        check_camera_path,
        export_camera,
        read_camera,
    )
else:
    load_on_use(__name__)
