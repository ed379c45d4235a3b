"""Cameras with one interface: GenICam through Aravis, UVC through OpenCV, folders of images, and simulated ones."""

from scanrig.cameras.camera import Camera, CameraIdentity, CameraSettings, Features, Frame, require_same
from scanrig.cameras.opening import list_cameras, open_camera, reopen_camera
