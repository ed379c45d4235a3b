"""Microsteps of the table, and what a GRBL board counts in."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TableUnits:
    """How a board's axis counts a turn of the table."""

    microsteps_per_turn: int
    units_per_turn: float
    """In what the board calls millimetres."""
    reverse: bool = False
    """Whether the table turns upwards where the axis counts downwards."""

    @property
    def steps_per_unit(self) -> float:
        """As the board's setting $100 has to be."""
        return self.microsteps_per_turn / self.units_per_turn

    def units(self, microsteps: float) -> float:
        """Microsteps in units of the axis."""
        return (-microsteps if self.reverse else microsteps) / self.steps_per_unit

    def microsteps(self, units: float) -> int:
        """Units of the axis in microsteps, the nearest."""
        return round((-units if self.reverse else units) * self.steps_per_unit)
