"""Serial lines."""

from __future__ import annotations

import serial
from serial.tools import list_ports

open_line = serial.Serial


def ports() -> dict[str, str]:
    """Return the serial ports, each with what identifies its device among others of its kind.

    This is the serial number of a USB device, or else the socket into which it is plugged.
    """
    return {
        port.device: port.serial_number or port.location or port.device
        for port in list_ports.comports()
    }
