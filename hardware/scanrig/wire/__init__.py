"""The line to a controller: serial ports, finding them again, recording what goes over them and playing it again."""

from scanrig.wire.link import Link as Link
from scanrig.wire.ports import PortInfo as PortInfo
from scanrig.wire.ports import choose_port as choose_port
from scanrig.wire.ports import describe as describe
from scanrig.wire.ports import find_again as find_again
from scanrig.wire.ports import find_ports as find_ports
from scanrig.wire.ports import identify as identify
from scanrig.wire.serial import SerialLink as SerialLink
from scanrig.wire.serial import open_serial as open_serial
from scanrig.wire.transcript import RecordingLink as RecordingLink
from scanrig.wire.transcript import TranscriptLink as TranscriptLink
