"""The public names of every room: listed once, loaded when they are used."""

import importlib
import subprocess
import sys

import pytest

ROOMS = ("rig", "acquisition", "calibration", "processing", "simulator")
# What a room must not load before one of its names is used.
HEAVY = ("numpy", "scipy", "cv2", "numba", "OpenImageIO", "pydantic", "harvesters", "rawpy")


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_exists(room):
    module = importlib.import_module(room)
    assert set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        assert getattr(module, name) is not None


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_loads_nothing_heavy_by_itself(room):
    code = f"import sys, {room}; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("room", ROOMS)
def test_a_name_that_does_not_exist(room):
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = importlib.import_module(room).no_such_name
