"""The settings ($$) of the simulated board."""

SETTINGS = {
    1: 255.0,  # step idle delay: 255 keeps the motor on
    10: 1.0,  # reports have MPos
    13: 0.0,  # reports in millimetres
    21: 0.0,  # hard limits
    22: 1.0,  # homing
    23: 1.0,  # homing downwards
    25: 60000.0,  # homing seek, units/min
    27: 1.0,  # pull-off
    30: 1000.0,  # largest S
    32: 0.0,  # laser mode
    100: 80.0,  # steps per unit
    110: 60000.0,  # largest rate, units/min
    120: 20000.0,  # acceleration, units/s²
    130: 400.0,  # travel
}
"""Settings of a fast board: tests are about its logic."""
