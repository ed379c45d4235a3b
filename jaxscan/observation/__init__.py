"""Captures of a board to observations: corners and stripes on the board, in a first and a second look."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.observation.board_map import FoundCorners
    from jaxscan.observation.first_look import Eyes, Look, Progress, look_at_boards, stack_stripes, to_observations
    from jaxscan.observation.observations import (
        CONTRAST_CLASSES,
        BoardViews,
        Observations,
        StripeViews,
        with_lasers,
    )
    from jaxscan.observation.prediction import PredictedCorners, SolvedRig
    from jaxscan.observation.records import BoardRecord, BoardSource, SeenRecord
    from jaxscan.observation.second_look import look_again
    from jaxscan.observation.stripes_on_board import BoardStripe, FoundStripe, select_board_stripe
else:
    load_on_use(__name__)
