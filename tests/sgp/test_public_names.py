"""The public names of every package: listed once, loaded when they are used."""

import importlib
import subprocess
import sys

import pytest

PACKAGES = ("rig", "acquisition", "calibration", "processing", "simulator")
# Modules that a package must not import before one of its names is used.
HEAVY = ("numpy", "scipy", "cv2", "numba", "OpenImageIO", "pydantic", "harvesters", "rawpy")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_exists(package):
    module = importlib.import_module(package)
    assert set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        assert getattr(module, name) is not None


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_nothing_heavy_by_itself(package):
    code = f"import sys, {package}; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_that_does_not_exist(package):
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = importlib.import_module(package).no_such_name
