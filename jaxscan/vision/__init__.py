"""OpenCV, and no other library's: detectors of boards, pictures of boards, image files, grey pictures."""

from jaxscan.vision.boards import Detector as Detector
from jaxscan.vision.boards import board_texture as board_texture
from jaxscan.vision.boards import find_corners as find_corners
from jaxscan.vision.grey import to_grey as to_grey
from jaxscan.vision.images import MAX_PIXELS as MAX_PIXELS
from jaxscan.vision.images import decode_image as decode_image
from jaxscan.vision.images import encode_png as encode_png
