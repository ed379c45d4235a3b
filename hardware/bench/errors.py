"""Errors of the bench itself, not of the rig that it simulates."""

from jaxscan.errors import JaxscanError


class BenchError(JaxscanError):
    """A tool is missing, a build failed, or a part of the bench does not answer."""
