"""Fixtures for tests without a rig; see docs/testing-without-hardware.md.

pytest imports this module in every run, so slow imports wait until a fixture is first used.
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

from sgp.cli.entry import foreign_package

if TYPE_CHECKING:
    from rig import Rig
    from simulator import Rendering, Scene, Truth

_OPTIONS = {
    "scene": "scene of the simulated rig: a name that `sgp simulate list` prints, or a .toml file",
    "size": "size of the image in pixels, WIDTHxHEIGHT",
    "leds": "number of LEDs",
    "seed": "seed of surface, lights and noise",
    "noise": "false disables the noise of the sensor",
}
# Small and quick. A scene file has its own size, number of LEDs and seed.
_SCENE = "coin"
_OF_NAMED_SCENES = {"size": "160x128", "leds": 12, "seed": 0}
_MARKER = (
    "sgp(scene, size, leds, seed, noise): options of the fixtures simulated_rig, "
    "simulated_session and simulated_truth, which override the ini options sgp_*"
)


@dataclass(frozen=True)
class _Bench:
    """The simulated scene; the fields are the arguments of the marker.

    None means the value of the scene.
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
            raise ValueError(f"size {self.size!r} must have the form 160x128")
        for name, least in (("leds", 1), ("seed", 0)):
            value = getattr(self, name)
            if value is not None and (type(value) is not int or value < least):
                raise ValueError(f"{name} {value!r} is not a whole number of at least {least}")

    def build(self, root: Path) -> Scene:
        """Return the scene; paths of scene files are relative to the folder of the ini file."""
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
    """Renders and records each scene once per test run."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._root = root
        self._folder = folder
        self.rendering = cache(self._render)
        self.session = cache(self._record)

    def _render(self, bench: _Bench) -> Rendering:
        from simulator import render

        rendering = render(bench.build(self._root))
        # Tests share it, so it is read-only: a test that writes into it fails itself.
        for field in fields(rendering.truth):
            if hasattr(values := getattr(rendering.truth, field.name), "setflags"):
                values.setflags(write=False)
        return rendering

    def _record(self, bench: _Bench) -> Path:
        from sgp.sessions import metered_exposures, record_simulated
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
    """Declare the ini options ``sgp_scene``, ``sgp_size``, ``sgp_leds`` and so on."""
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
    """Combine the options of the ini file and of the test's markers; the closest marker wins."""
    # pytest adds the folders of tests to the search path, and one may contain a rig.py.
    if (complaint := foreign_package()) is not None:
        pytest.fail(f"sgp: {complaint}", pytrace=False)
    stated = {name: request.config.getini(f"sgp_{name}") for name in _OPTIONS}
    options: dict[str, Any] = {name: text for name, text in stated.items() if text}
    for name in ("leds", "seed"):
        if str(options.get(name)).isdecimal():
            options[name] = int(options[name])
    if "noise" in options:
        options["noise"] = {"true": True, "false": False}.get(
            options["noise"].lower(), options["noise"]
        )
    for marker in reversed(list(request.node.iter_markers("sgp"))):
        for name in (*marker.args, *marker.kwargs):
            if marker.args or name not in _OPTIONS:
                pytest.fail(
                    f"the marker sgp accepts {', '.join(_OPTIONS)} as keywords, not {name!r}",
                    pytrace=False,
                )
        options |= marker.kwargs
    options.setdefault("scene", _SCENE)
    if not str(options["scene"]).endswith(".toml"):
        options = _OF_NAMED_SCENES | options
    try:
        return _Bench(**options)
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
    # Outside of `except`, so that pytest does not print the chain of errors.
    pytest.fail(f"sgp: {complaint}", pytrace=False)


@pytest.fixture
def simulated_rig(_sgp_bench: _Bench, _sgp_rendering: Rendering) -> Iterator[Rig]:
    """Yield an open `rig.Rig` with a virtual board and camera; it is closed after the test.

    The rig does not wait for the exposure times to pass.
    """
    from simulator import open_rig_seeing

    with open_rig_seeing(
        _sgp_rendering, seed=_sgp_bench.seed or 0, noisy=_sgp_bench.noise, realtime=False
    ) as rig:
        yield rig


@pytest.fixture
def simulated_session(
    _sgp_bench: _Bench, _sgp_rendering: Rendering, _sgp_studio: _Studio, tmp_path: Path
) -> Path:
    """Return the folder of a complete recorded session, a separate copy for each test.

    It contains, for each exposure time, a dark frame and one frame per LED, the camera model, the
    sensor, and the ground truth in ``derived/truth``.
    """
    folder = tmp_path / "session"
    shutil.copytree(_sgp_studio.session(_sgp_bench), folder)
    return folder


@pytest.fixture
def simulated_truth(_sgp_rendering: Rendering) -> Truth:
    """Return the ground truth of the scene that rig and session show, read-only."""
    return _sgp_rendering.truth
