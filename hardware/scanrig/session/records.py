"""The header of a session's capture, and the fields of each record."""

from dataclasses import asdict
from importlib.metadata import version
from typing import Any, NamedTuple

from jaxscan.files.capture import CameraTable, CaptureHeader, PlanTable, TurntableTable
from scanrig.cameras import Features
from scanrig.config import RigConfig
from scanrig.controllers import Firmware
from scanrig.session.job import Job
from scanrig.session.plan import angle_deg
from scanrig.session.steps import ProvenPair


def capture_header(job: Job, firmware: Firmware, features: Features) -> CaptureHeader:
    """The header of a new capture, with the settings that must not change when it is resumed."""
    config, kind, identity = job.config, job.kind, job.devices.camera.identity
    acquisition: dict[str, Any] = {
        "software": f"jaxscan {version('jaxscan')}",
        "started": job.devices.clock.utc(),
        "config_sha256": config.digest(kind),
        "microsteps_per_turn": config.microsteps_per_turn,
        "firmware": firmware.version,
        "protocol": firmware.proto,
        "boot": firmware.boot,
        "camera": asdict(identity),
        "features": dict(features),
        "config": config.frame_tables(kind),
    }
    if job.calibration_digest is not None:
        acquisition["calibration"] = job.calibration_digest
    camera = config.camera
    return CaptureHeader(
        kind=kind,
        camera=CameraTable(
            width=camera.width,
            height=camera.height,
            pixel_format=camera.pixel_format,
            response=camera.response,
            up=camera.up,
        ),
        turntable=TurntableTable(carries=config.turntable.carries, angle_sigma_deg=config.turntable.angle_sigma_deg),
        laser=tuple(laser.table for laser in config.laser),
        board=config.board if kind == "calibration" else None,
        plan=PlanTable(steps=job.planned),
        acquisition=acquisition,
    )


class Moment(NamedTuple):
    """When a pair was taken."""

    utc: str
    """Time of day, RFC 3339."""
    now_s: float
    """Monotonic seconds."""


def record_fields(pair: ProvenPair, config: RigConfig, features: Features, moment: Moment) -> dict[str, Any]:
    """The fields of a record, without its images and their digests."""
    n, proof = config.microsteps_per_turn, pair.proof
    exposure = features.get("exposure_s", config.camera.exposure_ms / 1000)
    fields: dict[str, Any] = {
        "angle_deg": angle_deg(pair.position, n),
        "time": moment.utc,
        "time_s": round(moment.now_s, 6),
        "microsteps": pair.position,
        "microsteps_per_turn": n,
        "exposure_s": exposure,
        "retakes": len(pair.rejected),
        "frame_ids": [pair.on.number, pair.off.number],
        "statistics": {
            "lit_lines": round(proof.lit_lines, 4),
            "peak_dn": round(proof.peak_dn, 2),
            "saturated": round(proof.saturated, 4),
            "ambient_dn": round(proof.ambient_dn, 3),
            "unrest": round(proof.unrest, 3),
        },
    }
    if len(config.laser) > 1:
        fields["lasers"] = [config.laser[pair.laser].name]
    if pair.rejected:
        fields["rejected"] = list(pair.rejected)
    return fields
