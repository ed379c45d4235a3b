"""Cameras: GenICam by Aravis, UVC by OpenCV, folders of images, and simulated ones, behind one interface."""

from scanrig.cameras.frame import Camera, CameraIdentity, Features, Frame
from scanrig.cameras.opening import list_cameras, open_camera
from scanrig.cameras.settings import CameraSettings
