"""The page of a report in a headless Chromium: shading, light, keyboard, safety."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

from rig import MAX_PIXELS
from sgp._report.folder import read_folder
from sgp._report.maps import embed
from tests.sgp.chromium import MISSING, PROGRAM, Browser
from tests.sgp.report_folder import shaded, write_folder

pytestmark = pytest.mark.skipif(PROGRAM is None, reason=MISSING)

LIGHTS = [(135, 45), (0, 10), (80, 30), (200, 60), (300, 20), (0, 90)]
PIXELS = """(() => {
  const canvas = document.querySelector("canvas");
  const gl = canvas.getContext("webgl2");
  const data = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, data);
  let text = "";
  for (let i = 0; i < data.length; i += 8192)
    text += String.fromCharCode(...data.subarray(i, i + 8192));
  return [canvas.width, canvas.height, btoa(text)];
})()"""
FRAME = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_folder(tmp_path_factory.mktemp("report") / "ball")


@pytest.fixture(scope="module")
def planes(folder):
    return embed(read_folder(folder), 1e6, MAX_PIXELS).planes


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("chromium"), "--enable-unsafe-swiftshader")
    yield browser
    browser.close()


def opened(browser: Browser, path: Path, fragment: str = "") -> Browser:
    browser.open(path, fragment)
    browser.until("Number(document.querySelector('canvas')?.dataset.drawn ?? 0) > 1")
    browser.until("document.querySelector('canvas').dataset.shown?.trim().split(' ').length === 2")
    return browser


@pytest.fixture(scope="module")
def page(tmp_path_factory, folder) -> Path:
    from sgp.app import build, run

    path = tmp_path_factory.mktemp("page") / "ball.html"
    assert run(build(["report"]), ["report", str(folder), "--out", str(path)]) == 0
    return path


def show(browser: Browser, mode: str, light: tuple[float, float]) -> np.ndarray:
    """Show a mode under a light at 1:1 and return the pixels of the map, cut out of the canvas."""
    azimuth, elevation = light
    browser.value(f"location.hash = 'zoom=1&show={mode}&light={azimuth},{elevation}'")
    browser.until(f"document.querySelector('canvas').dataset.shown.startsWith('{mode} ')")
    browser.value(FRAME)
    return pixels(browser)


def pixels(browser: Browser) -> np.ndarray:
    width, height, text = browser.value(PIXELS)
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)[::-1]


def at_map(canvas: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Cut the map out of the canvas, in whose middle it is at 1:1."""
    top, left = (round((a - b) / 2) for a, b in zip(canvas.shape[:2], size, strict=True))
    return canvas[top : top + size[0], left : left + size[1]]


def quiet(browser: Browser, page: Path) -> None:
    """Assert that the page requested nothing but itself and reported nothing."""
    browser.value("1")
    own = page.resolve().as_uri()
    outside = [url for url in browser.requests if not url.startswith((own, "data:", "blob:"))]
    reported = [line for line in browser.messages if "GPU stall due to ReadPixels" not in line]
    assert (outside, reported) == ([], [])


def test_a_page_opens_and_is_shaded_as_numpy_shades_its_planes(browser, page, planes):
    opened(browser, page)
    found = at_map(show(browser, "shaded", LIGHTS[0]), planes["normals"].samples.shape[:2])
    expected = shaded(planes, "shaded", LIGHTS[0])
    assert expected.max() > 150
    assert np.abs(found[..., :3] - expected).max() <= 2
    quiet(browser, page)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["shaded", "matte", "specular", "shape", "detail", "normals"])
def test_every_mode_that_shades_equals_numpy_under_six_lights(browser, page, planes, mode):
    opened(browser, page)
    size = planes["normals"].samples.shape[:2]
    for light in LIGHTS:
        found = at_map(show(browser, mode, light), size)[..., :3]
        expected = shaded(planes, mode, light)
        assert np.abs(found - expected).max() <= 2, light
    quiet(browser, page)
