"""Boards that speak GRBL's G-code or a dialect of it: no watchdog, no checksums, no wire to the camera.

Source: "Grbl v1.1 Interface", "Grbl v1.1 Commands" and "Grbl v1.1 Laser Mode" of github.com/gnea/grbl.
"""

from scanrig.controllers.grbl.controller import GrblController, connect_grbl
