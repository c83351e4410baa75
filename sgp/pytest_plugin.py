"""Fixtures for the tests of those who have no rig at hand; see docs/testing-without-hardware.md.

pytest imports this in every run, so all that is heavy is imported when a fixture is first used.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from sgp._entry import foreign_package

if TYPE_CHECKING:
    from rig import Rig
    from simulator import Rendering, Scene, Truth

_OPTIONS = {
    "scene": "what the simulated rig sees: a name that `sgp simulate list` prints, or a .toml file",
    "size": "its camera's pixels, WIDTHxHEIGHT",
    "leds": "its number of LEDs",
    "seed": "seed of its surface, lights and noise",
    "noise": "false leaves the sensor's noise out",
}
# Small and quick. A scene file has its own size, LEDs and seed.
_SCENE = "coin"
_OF_NAMED_SCENES = {"size": "160x128", "leds": 12, "seed": 0}
_MARKER = (
    "sgp(scene, size, leds, seed, noise): what the fixtures simulated_rig, simulated_session and "
    "simulated_truth see, where it differs from the ini options sgp_*"
)


@dataclass(frozen=True)
class _Bench:
    """What lies under the simulated camera; the fields are the marker's arguments.

    None is the scene's own.
    """

    scene: str
    size: str | None = None
    leds: int | None = None
    seed: int | None = None
    noise: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.scene, str):
            raise ValueError(f"scene {self.scene!r} is not a name")
        if not isinstance(self.noise, bool):
            raise ValueError(f"noise {self.noise!r} is neither true nor false")
        if self.size is not None and _pixels(self.size) is None:
            raise ValueError(f"size {self.size!r} must read like 160x128")
        for name, least in (("leds", 1), ("seed", 0)):
            value = getattr(self, name)
            if value is not None and (type(value) is not int or value < least):
                raise ValueError(f"{name} {value!r} is not a whole number from {least} on")

    def build(self, root: Path) -> Scene:
        """Make the scene; a scene file is found from the folder of the ini file."""
        from simulator import read_scene, scene_named

        options: dict[str, Any] = {"leds": self.leds, "seed": self.seed}
        pixels = None if self.size is None else _pixels(self.size)
        if self.scene.endswith(".toml"):
            return read_scene(root / self.scene, size=pixels, **options)
        if pixels is not None:
            options["width"], options["height"] = pixels
        return scene_named(self.scene, **options)


def _pixels(size: object) -> tuple[int, int] | None:
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", str(size))
    return None if match is None else (int(match[1]), int(match[2]))


class _Studio:
    """Renders and records each bench once in a test run."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._root = root
        self._folder = folder
        self.rendering = cache(self._render)
        self.session = cache(self._record)

    def _render(self, bench: _Bench) -> Rendering:
        from simulator import render

        rendering = render(bench.build(self._root))
        # Tests share it: one that writes into it must fail, and not the next one.
        for field in fields(rendering.truth):
            if hasattr(values := getattr(rendering.truth, field.name), "setflags"):
                values.setflags(write=False)
        return rendering

    def _record(self, bench: _Bench) -> Path:
        from sgp._simulation import metered_exposures, record_simulated
        from simulator import save_truth

        rendering = self.rendering(bench)
        exposures_us = metered_exposures(rendering)
        folder = self._folder / str(len(list(self._folder.iterdir())))
        record_simulated(
            rendering,
            folder,
            exposures_us=exposures_us,
            object_name=Path(bench.scene).stem,
            seed=bench.seed or 0,
            noisy=bench.noise,
        )
        save_truth(folder / "derived" / "truth", rendering, exposures_us=exposures_us)
        return folder


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the ini options ``sgp_scene`` and so on."""
    for name, text in _OPTIONS.items():
        parser.addini(f"sgp_{name}", text, default="")


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker."""
    config.addinivalue_line("markers", _MARKER)


@pytest.fixture(scope="session")
def _sgp_studio(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> _Studio:
    return _Studio(pytestconfig.rootpath, tmp_path_factory.mktemp("simulated-sessions"))


@pytest.fixture
def _sgp_bench(request: pytest.FixtureRequest) -> _Bench:
    """Put together what the ini file and the test's markers say; the closest marker wins."""
    # pytest puts the folders of tests on the search path, and a rig.py may lie there.
    if (complaint := foreign_package()) is not None:
        pytest.fail(f"sgp: {complaint}", pytrace=False)
    stated = {name: request.config.getini(f"sgp_{name}") for name in _OPTIONS}
    said: dict[str, Any] = {name: text for name, text in stated.items() if text}
    for name in ("leds", "seed"):
        if str(said.get(name)).isdecimal():
            said[name] = int(said[name])
    if "noise" in said:
        said["noise"] = {"true": True, "false": False}.get(said["noise"].lower(), said["noise"])
    for marker in reversed(list(request.node.iter_markers("sgp"))):
        for name in (*marker.args, *marker.kwargs):
            if marker.args or name not in _OPTIONS:
                pytest.fail(
                    f"the marker sgp takes {', '.join(_OPTIONS)} by name, not {name!r}",
                    pytrace=False,
                )
        said |= marker.kwargs
    said.setdefault("scene", _SCENE)
    if not str(said["scene"]).endswith(".toml"):
        said = _OF_NAMED_SCENES | said
    try:
        return _Bench(**said)
    except ValueError as error:
        complaint = str(error)
    pytest.fail(f"sgp: {complaint}", pytrace=False)


@pytest.fixture
def _sgp_rendering(_sgp_bench: _Bench, _sgp_studio: _Studio) -> Rendering:
    from acquisition import DataError, MissingPathError

    try:
        return _sgp_studio.rendering(_sgp_bench)
    except (DataError, MissingPathError) as error:
        complaint = str(error)
    # Out here, so that pytest does not print the chain of errors behind it.
    pytest.fail(f"sgp: {complaint}", pytrace=False)


@pytest.fixture
def simulated_rig(_sgp_bench: _Bench, _sgp_rendering: Rendering) -> Iterator[Rig]:
    """Yield an open `rig.Rig` on a virtual board and camera; it is closed after the test.

    It does not wait for exposures to pass.
    """
    from simulator import rig_for

    with rig_for(
        _sgp_rendering, seed=_sgp_bench.seed or 0, noisy=_sgp_bench.noise, realtime=False
    ) as rig:
        yield rig


@pytest.fixture
def simulated_session(
    _sgp_bench: _Bench, _sgp_rendering: Rendering, _sgp_studio: _Studio, tmp_path: Path
) -> Path:
    """Return the folder of a complete recorded session, the test's own copy.

    It holds a dark frame and every LED for each exposure, the camera model, the sensor, and in
    ``derived/truth`` what is true.
    """
    folder = tmp_path / "session"
    shutil.copytree(_sgp_studio.session(_sgp_bench), folder)
    return folder


@pytest.fixture
def simulated_truth(_sgp_rendering: Rendering) -> Truth:
    """Return what is true of the scene that rig and session show, read-only."""
    return _sgp_rendering.truth
