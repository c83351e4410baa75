"""The public names of every package and namespace: listed once, loaded when they are used."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.public_names import NAMESPACES, ROOMS, namespaces

# Modules that a package must not import before one of its names is used.
HEAVY = ("numpy", "scipy", "cv2", "numba", "OpenImageIO", "pydantic", "harvesters", "rawpy")

FOLDERS_OF_SGP = sorted(
    f"sgp.{path.parent.name}" for path in Path(__file__).parents[2].glob("sgp/*/__init__.pyi")
)


@pytest.mark.parametrize("place", [*ROOMS, *NAMESPACES, *FOLDERS_OF_SGP])
def test_every_public_name_exists(place):
    module = importlib.import_module(place)
    assert set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        assert getattr(module, name) is not None


@pytest.mark.parametrize("room", ROOMS)
def test_a_name_at_the_top_is_the_one_of_its_namespace(room):
    module, found = importlib.import_module(room), 0
    for place in namespaces(room):
        space = importlib.import_module(place)
        for name in {*module.__all__} & {*space.__all__}:
            assert getattr(module, name) is getattr(space, name)
            found += 1
    assert found


@pytest.mark.parametrize("room", ROOMS)
def test_a_package_and_its_namespaces_import_nothing_heavy_by_themselves(room):
    code = (
        f"import sys, {', '.join([room, *namespaces(room)])}; "
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("place", [*ROOMS, *NAMESPACES])
def test_a_name_that_does_not_exist(place):
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = importlib.import_module(place).no_such_name


def test_a_namespace_is_an_attribute_of_its_package():
    code = "import processing; print(processing.surface.Jumps.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "Jumps"


def test_help_on_a_namespace_begins_with_what_it_has():
    lines = {place: (importlib.import_module(place).__doc__ or "").strip() for place in NAMESPACES}
    assert all(re.match(r"[A-Z].{15,}", text) for text in lines.values()), lines
    assert len({text.splitlines()[0] for text in lines.values()}) == len(NAMESPACES)


@pytest.mark.parametrize("room", ["acquisition", "calibration", "processing"])
def test_help_on_a_package_lists_its_names_by_task(room):
    module = importlib.import_module(room)
    spaces = [name.partition(".")[2] for name in namespaces(room)]
    text, _, listed = module.__doc__.partition("Namespaces: ")
    assert re.findall(r"\w+", listed) == sorted(spaces)
    names = " ".join(re.findall(r"(?m)^    (\w+(?:, \w+)*)  +\S", text)).replace(",", "").split()
    # The two curves are named in the line of their class.
    curves = {"LINEAR", "SRGB"} & {*module.__all__}
    assert sorted(names) == sorted({*module.__all__} - {*spaces} - curves)
    assert all(curve in text for curve in curves)
