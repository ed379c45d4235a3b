"""What goes wrong on the bench itself, not in the rig that it imitates."""

from jaxscan.errors import JaxscanError


class BenchError(JaxscanError):
    """A tool is missing, a build failed, or a part of the bench does not answer."""
