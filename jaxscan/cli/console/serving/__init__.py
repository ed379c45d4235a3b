"""The console for browsers: its addresses, its socket, who operates, and the viewer for finished clouds."""

from jaxscan.cli.console.serving.looks import Looks
from jaxscan.cli.console.serving.site import make_site
