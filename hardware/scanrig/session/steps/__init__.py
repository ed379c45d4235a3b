"""One step, from the motion to the disk.

`grab.py` takes the two frames, `step.py` repeats that until they are believed, or proven. `flights.py` follows the
pairs that are proven and written in the background.
"""

from scanrig.session.steps.flights import Flight, Flights, Place
from scanrig.session.steps.grab import FrameNumbers, Station, Step, TakenPair, next_frame, plain_frame, rest
from scanrig.session.steps.step import Doubt, ProvenPair, grab_whole, prove, take_pair
