"""A small recording, and a fixture that runs commands as from the command line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest

from acquisition import SRGB, Lights, write_lights, write_png
from acquisition.files import BandStore
from sgp import read_record
from sgp.app import build, run
from sgp.results import COMMANDS, check_metrics
from sgp.results.metrics import RECORD_FORMAT
from tests.real_data import DATA
from tests.sgp.chromium import Browser
from tests.sgp.small_rig import RIG, WORLD_RIG, capture
from tests.sgp.virtual_bench import Bench

SIZE = (40, 48)
# As fine as cameras save them: coarser JPEGs differ by what the compression changes, not the curve.
FINE = (
    cv2.IMWRITE_JPEG_QUALITY, 100,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
)  # fmt: skip


class Answer(NamedTuple):
    code: int
    out: str
    err: str

    def ok(self) -> Answer:
        """Assert that the command succeeded, and return its answer."""
        assert self.code == 0, self
        return self

    def report(self) -> dict[str, Any]:
        """Return the object that a command printed that succeeded with ``--json``."""
        return json.loads(self.ok().out)

    def figures(self) -> dict[str, Any]:
        """Return the figures of a command that succeeded with ``--json``."""
        return self.report()["metrics"]

    def codes(self) -> list[str]:
        """Return the codes of the notices of a command that succeeded with ``--json``."""
        return [notice["code"] for notice in self.report()["notices"]]

    def error_line(self, code: int) -> str:
        """Assert that stderr is a single error line, and return it."""
        assert self.code == code, self
        assert self.out == ""
        (line,) = self.err.splitlines()
        assert line.startswith("error: ")
        return line


def check_figures(words: list[str], printed: str) -> None:
    """Check the figures of a command that succeeded, as printed and in its records."""
    lines = "--events" in words
    if printed.startswith("{") and not lines and words[:2] != ["simulate", "list"]:
        for count in (1, 2):
            command, metrics = " ".join(["sgp", *words[:count]]), json.loads(printed)["metrics"]
            check_metrics(command, metrics, declared_only=True)
    if "--out" in words:
        for path in Path(words[words.index("--out") + 1]).rglob("*.json"):
            if RECORD_FORMAT in path.read_text(errors="replace"):
                record = read_record(path)
                assert record.command in COMMANDS
                check_metrics(record.command, record.metrics, declared_only=True)


@pytest.fixture
def sgp(capsys) -> Callable[..., Answer]:
    """Call ``sgp`` with arguments; return exit code, stdout and stderr.

    The figures that it prints as JSON, and those in the records that it leaves, are checked.
    """

    def call(*words: object) -> Answer:
        capsys.readouterr()
        tokens = [str(word) for word in words]
        code = run(build(tokens), tokens)
        printed = capsys.readouterr()
        if code == 0:
            check_figures(tokens, printed.out)
        return Answer(code, printed.out, printed.err)

    return call


@pytest.fixture
def bands(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, slice]]:
    """What is completed of maps in files: a step, and its rows or units."""
    done: list[tuple[str, slice]] = []
    complete = BandStore.complete

    def noted(store: BandStore, step: str, units: slice) -> None:
        complete(store, step, units)
        done.append((step, units))

    monkeypatch.setattr(BandStore, "complete", noted)
    return done


def ring_lights(count: int = 8) -> Lights:
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return Lights(directions=np.stack([np.cos(around), np.sin(around), np.full(count, 1.5)], 1))


def ball() -> tuple[np.ndarray, np.ndarray]:
    """Return normals and mask of a ball in the middle of the frame."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = (columns - 23.5) / 16, -(rows - 19.5) / 16
    mask = x**2 + y**2 < 0.9
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    return np.where(mask[..., None], np.stack([x, y, z], -1), 0.0), mask


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Eight 16-bit images of a Lambertian ball, with lights.json next to their folder."""
    folder = tmp_path / "ball"
    folder.mkdir()
    lights = ring_lights()
    write_lights(tmp_path / "lights.json", lights)
    normals, _ = ball()
    for i, light in enumerate(lights.unit_directions):
        shade = 0.7 * np.clip(normals @ light, 0, 1)
        write_png(folder / f"ball.{i}.png", np.rint(shade * 65535).astype(np.uint16))
    return folder


def photographed(folder: Path, albedo: Any) -> Path:
    """Write fine sRGB JPEGs of the ball and its mask, with lights.json next to their folder."""
    folder.mkdir()
    normals, mask = ball()
    write_lights(folder.parent / "lights.json", lights := ring_lights())
    write_png(folder / "mask.png", mask.astype(np.uint8) * np.uint8(255))
    for i, light in enumerate(lights.unit_directions):
        linear = np.multiply.outer(np.clip(normals @ light, 0, 1), albedo)
        samples = np.rint(SRGB.samples(linear) * 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"b.{i}.jpg"), np.atleast_3d(samples)[..., ::-1], FINE)
    return folder


@pytest.fixture(scope="session")
def uw_lights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The lights of a real chrome ball."""
    out = tmp_path_factory.mktemp("uw") / "lights.json"
    words = ["calibrate", "spheres", str(DATA / "uw" / "chrome"), "--out", str(out)]
    assert run(build(), words) == 0
    return out


@pytest.fixture
def rig(simulated_world: None, tmp_path: Path) -> Path:
    """A rig file of the small simulated rig, which the test uses in virtual time."""
    path = tmp_path / "rig.toml"
    path.write_text(WORLD_RIG, encoding="utf-8")
    return path


@pytest.fixture
def real_rig(tmp_path: Path) -> Path:
    """A rig file of the small simulated rig with its processes, for programs that tests start."""
    path = tmp_path / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    return path


@pytest.fixture
def plan(tmp_path: Path) -> Callable[[float], Path]:
    """Write a plan of six LEDs with one exposure time."""

    def write(exposure_us: float) -> Path:
        path = tmp_path / "plan.toml"
        path.write_text(f"leds = [0,1,2,3,4,5]\nexposures_us = [{exposure_us}]\n", encoding="utf-8")
        return path

    return write


@pytest.fixture
def recorded(sgp, rig: Path, plan: Callable[[float], Path], tmp_path: Path) -> Path:
    """A complete session of the small rig."""
    capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0)).ok()
    return tmp_path / "s"


@pytest.fixture
def with_flats(tmp_path: Path) -> Path:
    """A plan with flats, which wait for the white card."""
    path = tmp_path / "flats.toml"
    path.write_text("leds = [0, 1, 2]\nexposures_us = [5000]\nflats = 3\n", encoding="utf-8")
    return path


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """A bench whose board and camera are closed after the test."""
    bench = Bench(tmp_path)
    yield bench
    bench.close()


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Start a headless Chromium, which all tests of pages share."""
    browser = Browser(tmp_path_factory.mktemp("chromium"), "--enable-unsafe-swiftshader")
    yield browser
    browser.close()
