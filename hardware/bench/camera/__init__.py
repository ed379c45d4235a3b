"""The camera on the bench: from the rig's log to pictures on the network."""

from bench.camera.network import aravis_is_there
from bench.camera.rendered import ADDRESS, RenderedCamera, loopback
