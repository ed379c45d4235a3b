"""Boards that are no parabola: which shape a solve may have, and the shape that it found."""

from jaxscan.calibration.board_shape.choose import ShapeChoice, choose_shape, describe_board
