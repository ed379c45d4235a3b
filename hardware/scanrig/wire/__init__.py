"""The link to a controller: serial ports, finding them again, recording and replaying their traffic."""

from scanrig.wire.link import Link
from scanrig.wire.ports import PortInfo, choose_port, describe, find_again, find_ports, identify
from scanrig.wire.serial import SerialLink, open_serial
from scanrig.wire.transcript import RecordingLink, TranscriptLink
