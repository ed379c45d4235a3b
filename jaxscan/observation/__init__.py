"""Captures of a board to observations: corners, stripes on the board, and a second look at both."""

from jaxscan.observation.corners import FoundCorners as FoundCorners
from jaxscan.observation.first_look import Eyes as Eyes
from jaxscan.observation.first_look import Look as Look
from jaxscan.observation.first_look import Progress as Progress
from jaxscan.observation.first_look import look_at_boards as look_at_boards
from jaxscan.observation.observations import BoardViews as BoardViews
from jaxscan.observation.observations import Observations as Observations
from jaxscan.observation.observations import StripeViews as StripeViews
from jaxscan.observation.observations import stack_stripes as stack_stripes
from jaxscan.observation.observations import to_observations as to_observations
from jaxscan.observation.prediction import SolvedRig as SolvedRig
from jaxscan.observation.records import BoardRecord as BoardRecord
from jaxscan.observation.records import BoardSource as BoardSource
from jaxscan.observation.records import SeenRecord as SeenRecord
from jaxscan.observation.second_look import look_again as look_again
from jaxscan.observation.stripes_on_board import BoardStripe as BoardStripe
from jaxscan.observation.stripes_on_board import FoundStripe as FoundStripe
from jaxscan.observation.stripes_on_board import select_board_stripe as select_board_stripe
