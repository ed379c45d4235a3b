"""Microsteps of the table, and the units of a GRBL board."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TableUnits:
    """Converts between microsteps of the table and units of a board's axis."""

    microsteps_per_turn: int
    units_per_turn: float
    """In the board's "millimetres"."""
    reverse: bool = False
    """Whether the table's angle grows while the axis counts downwards."""

    @property
    def steps_per_unit(self) -> float:
        """The value that the board's setting $100 must have."""
        return self.microsteps_per_turn / self.units_per_turn

    def units(self, microsteps: float) -> float:
        """Microsteps in units of the axis."""
        return (-microsteps if self.reverse else microsteps) / self.steps_per_unit

    def microsteps(self, units: float) -> int:
        """Units of the axis in microsteps, the nearest."""
        return round((-units if self.reverse else units) * self.steps_per_unit)
