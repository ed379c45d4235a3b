"""Cameras: GenICam by Aravis, UVC by OpenCV, folders of images, and simulated ones, behind one interface."""

from scanrig.cameras.frame import Camera as Camera
from scanrig.cameras.frame import CameraIdentity as CameraIdentity
from scanrig.cameras.frame import Features as Features
from scanrig.cameras.frame import Frame as Frame
from scanrig.cameras.opening import list_cameras as list_cameras
from scanrig.cameras.opening import open_camera as open_camera
from scanrig.cameras.settings import CameraSettings as CameraSettings
