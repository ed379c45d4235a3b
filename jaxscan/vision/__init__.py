"""All use of OpenCV: board detectors, pictures of boards, image files, conversion to grey."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.vision.boards import find_corners
    from jaxscan.vision.corners import refit_corners
    from jaxscan.vision.features import enough_texture, feature_eyes, find_targets, follow_features
    from jaxscan.vision.frames import to_grey
    from jaxscan.vision.images import MAX_PIXELS, decode_image, encode_png, is_jpeg, through_jpeg
    from jaxscan.vision.ink import Ink, board_ink, board_texture, draw_print
    from jaxscan.vision.other_boards import name_other_board
    from jaxscan.vision.pictures import encode_jpeg, encode_picture_png, read_panorama
    from jaxscan.vision.video import Video
    from jaxscan.vision.zstd import encode_zstd
else:
    load_on_use(__name__)
