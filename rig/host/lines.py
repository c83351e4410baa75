"""Serial lines."""

from __future__ import annotations

import serial

open_line = serial.Serial
