"""Captures of a board to observations: corners and stripes on the board, in a first and a second look."""

from jaxscan.observation.board_map import FoundCorners
from jaxscan.observation.first_look import Eyes, Look, Progress, look_at_boards
from jaxscan.observation.observations import (
    BoardViews,
    Observations,
    StripeViews,
    stack_stripes,
    to_observations,
    with_lasers,
)
from jaxscan.observation.prediction import PredictedCorners, SolvedRig
from jaxscan.observation.records import BoardRecord, BoardSource, SeenRecord
from jaxscan.observation.second_look import look_again
from jaxscan.observation.stripes_on_board import CONTRAST_CLASSES, BoardStripe, FoundStripe, select_board_stripe
