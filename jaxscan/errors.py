"""Typed errors: each message says the finding, the expectation and the remedy."""


class JaxscanError(Exception):
    """Base of all errors that a user can act on; the command line prints them in one line."""


class ConfigError(JaxscanError):
    """A configuration file that cannot be read or does not mean anything."""


class CaptureError(JaxscanError):
    """A capture that is missing, damaged, or unfit for the call."""


class CalibrationError(JaxscanError):
    """Observations that do not determine the scanner, or a calibration that does not fit its use."""


class GivenError(CalibrationError):
    """A known length, sphere or place that somebody gave, and that the sweeps contradict."""


class CloudError(JaxscanError):
    """A point cloud that cannot be read or written."""


class MeasurementError(JaxscanError):
    """A cloud without the thing to be measured."""


class OptionError(JaxscanError):
    """An option of the command line whose value cannot be meant."""


class OutputError(JaxscanError):
    """An output that cannot be written."""


class DependencyError(JaxscanError):
    """A library or system package that is needed for this call and is not installed."""


class BatchError(JaxscanError):
    """Steps of a batch that failed."""
