"""Cameras with one interface: GenICam through Aravis, UVC through OpenCV, folders of images, and simulated ones."""

from scanrig.cameras.features import require_same
from scanrig.cameras.frame import Camera, CameraIdentity, Features, Frame
from scanrig.cameras.opening import list_cameras, open_camera, reopen_camera
from scanrig.cameras.settings import CameraSettings
