"""The page of a report in a headless Chromium: shading, light, keyboard, safety."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

from rig import MAX_PIXELS
from sgp.report import FolderMaps, embed, read_folder
from tests.sgp.chromium import MISSING, PROGRAM, WINDOW, Browser
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
    return embed(FolderMaps(read_folder(folder), MAX_PIXELS), 1e6).planes


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
    status = f"Light: azimuth {azimuth}°, elevation {elevation}°"
    browser.until(f"document.querySelector('.status').textContent.startsWith('{status}')")
    browser.value(FRAME)
    return pixels(browser)


def pixels(browser: Browser) -> np.ndarray:
    width, height, text = browser.value(PIXELS)
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)[::-1]


def at_map(canvas: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Cut the map out of the canvas, in whose middle it is at 1:1."""
    top, left = ((a - b + 1) // 2 for a, b in zip(canvas.shape[:2], size, strict=True))
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


@pytest.mark.slow
def test_exaggerated_detail_equals_numpy(browser, page, planes):
    opened(browser, page)
    browser.value(
        "(() => { const one = [...document.querySelectorAll('.slider')]"
        ".find((row) => row.textContent.startsWith('Detail')).querySelector('input');"
        "one.value = 3; one.dispatchEvent(new Event('input')); })()"
    )
    found = at_map(show(browser, "matte", LIGHTS[2]), planes["normals"].samples.shape[:2])
    expected = shaded(planes, "matte", LIGHTS[2], exaggeration=3.0)
    assert np.abs(found[..., :3] - expected).max() <= 2


@pytest.mark.slow
def test_dragging_moves_the_light_and_keys_do(browser, page):
    opened(browser, page)
    status = "document.querySelector('.status').textContent"
    assert browser.value(status) == "Light: azimuth 135°, elevation 45°"
    before = pixels(browser)
    box = browser.value(
        "(({x, y, width, height}) => [x, y, width, height])"
        "(document.querySelector('canvas').getBoundingClientRect())"
    )
    x, y = box[0] + box[2] / 2, box[1] + box[3] / 2
    browser.drag((x, y - 30), (x + 0.3 * box[2], y))
    browser.value(FRAME)
    # The cosine of the elevation is the distance from the middle, 0.6 of the half width.
    assert browser.value(status) == "Light: azimuth 0°, elevation 53°"
    assert np.abs(pixels(browser).astype(int) - before).max() > 50
    for key, expected in (
        ("ArrowLeft", "azimuth 5°, elevation 53°"),
        ("ArrowDown", "azimuth 5°, elevation 48°"),
    ):
        browser.press(key)
        browser.value(FRAME)
        assert browser.value(status) == f"Light: {expected}"
    quiet(browser, page)


@pytest.mark.slow
def test_the_keyboard_reaches_every_control_with_a_visible_focus(browser, page):
    opened(browser, page)
    wanted = browser.value(
        "[...document.querySelectorAll('button, select, input, summary, [tabindex]')]"
        ".filter((one) => one.tabIndex >= 0 && !one.disabled && one.offsetParent !== null"
        " || one.matches('svg.dome')).length"
    )
    seen = set()
    for _ in range(wanted + 3):
        browser.press("Tab")
        index, outline, name = browser.value(
            "((one) => one === document.body ? [-1, '', ''] :"
            " [[...document.querySelectorAll('*')].indexOf(one),"
            " getComputedStyle(one).outlineStyle,"
            " one.getAttribute('aria-label') ?? (one.labels?.[0] ?? one).textContent])"
            "(document.activeElement)"
        )
        if index >= 0:
            seen.add(index)
            assert outline != "none", name
            assert name.strip()
    assert len(seen) >= wanted > 15


@pytest.mark.slow
def test_the_divider_compares_two_modes(browser, page, planes):
    opened(browser, page)
    show(browser, "matte", LIGHTS[0])
    browser.value("location.hash = 'layout=divider&zoom=1&show=matte&right=normals&light=135,45'")
    browser.until("document.querySelector('canvas').dataset.shown === 'matte normals'")
    browser.value(FRAME)
    canvas = pixels(browser)
    found = at_map(canvas, planes["normals"].samples.shape[:2])[..., :3]
    middle = round(canvas.shape[1] / 2) - (canvas.shape[1] - found.shape[1] + 1) // 2
    for part, mode in ((slice(0, middle - 1), "matte"), (slice(middle + 1, None), "normals")):
        expected = shaded(planes, mode, LIGHTS[0])
        assert np.abs(found - expected)[:, part].max() <= 2


@pytest.mark.slow
def test_hostile_names_and_texts_run_nothing(browser, tmp_path, capsys):
    from sgp.app import build, run

    hostile = "<script>window.hit=1</script><img src=x onerror='window.hit=1'>\"'&\u202eabc"
    folder = write_folder(
        tmp_path / "a <b> & 'c' \u202e",
        source=hostile,
        note=hostile,
        long="x" * 10_000,
        table={hostile: [hostile, 3]},
    )
    path = tmp_path / "page.html"
    assert run(build(["report"]), ["report", str(folder), "--out", str(path)]) == 0
    opened(browser, path)
    assert browser.value("window.hit ?? 0") == 0
    assert browser.value("document.title").startswith("a <b> & 'c' ")
    assert "<script>window.hit=1</script>" in browser.value("document.body.textContent")
    # Nothing is wider than the window.
    browser.resize(390, 844, mobile=True)
    browser.value(FRAME)
    assert browser.value("document.documentElement.scrollWidth") <= 390
    browser.resize(*WINDOW)
    quiet(browser, path)


@pytest.mark.slow
def test_without_webgl_pictures_under_eight_lights_are_there(tmp_path, page):
    browser = Browser(
        tmp_path, "--disable-gpu", "--disable-3d-apis", "--disable-software-rasterizer"
    )
    try:
        browser.open(page)
        browser.until("document.querySelector('.failed') !== null")
        shown = browser.value(
            "[...document.querySelectorAll('.prerendered img')]"
            ".filter((one) => one.offsetParent !== null && one.naturalWidth > 50).length"
        )
        assert shown == 8
        assert "WebGL2" in browser.value("document.querySelector('.failed').textContent")
        quiet(browser, page)
    finally:
        browser.close()
