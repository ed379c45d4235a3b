"""Boards of other programs, and the limits of all boards."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.geometry.boards.april_grid import AprilGrid
    from jaxscan.geometry.boards.circles import Circles
    from jaxscan.geometry.boards.limits import DICTIONARIES, check_board, known_dictionary
    from jaxscan.geometry.boards.picture import BoardPicture
else:
    load_on_use(__name__)
