"""The folder of real data that SGP_DATA names; tests that need it are skipped without it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("SGP_DATA", ""))
needs_data = pytest.mark.skipif(
    not os.environ.get("SGP_DATA"), reason="SGP_DATA names no folder of real data"
)
