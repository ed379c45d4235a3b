"""The settings of a solve as stored in a calibration file, so that it can be solved again."""

import math
from typing import Any

import pydantic

from jaxscan.calibration import CalibrationSettings
from jaxscan.errors import CalibrationError


# The file may come from anyone, so the length of the solve is bounded.
_MAX_STEPS = 10_000


def stored_settings(provenance: dict[str, Any], *, name: str) -> CalibrationSettings:
    """Settings from the provenance of a calibration; keys that an older file lacks have their defaults.

    Args:
        provenance: Provenance in the file.
        name: Name of the file, for messages.

    Raises:
        CalibrationError: With the key, if a value is not allowed.
    """
    settings = provenance.get("settings", {})
    if not isinstance(settings, dict):
        raise CalibrationError(f"{name}: provenance.settings: found {settings!r:.60}, expected a table.")
    priors = settings.get("priors", {})
    if isinstance(priors, dict):
        # JSON has no infinity: a prior that is switched off is written as null.
        priors = {key: math.inf if value is None else value for key, value in priors.items()}
    try:
        found = pydantic.TypeAdapter(CalibrationSettings).validate_python({**settings, "priors": priors})
    except pydantic.ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        key = ".".join(str(part) for part in ("provenance", "settings", *first["loc"]))
        raise CalibrationError(f"{name}: {key[:90]}: found {first['input']!r:.60}, {first['msg']}.") from None
    numbers = (found.huber, found.reject_any, found.reject_all, *found.priors.values())
    if not all(number > 0 for number in numbers) or not 1 <= found.max_steps <= _MAX_STEPS:
        raise CalibrationError(
            f"{name}: provenance.settings: priors and thresholds must be above 0, and max_steps 1 to {_MAX_STEPS}."
        )
    return found
