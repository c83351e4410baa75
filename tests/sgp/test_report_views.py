"""Views of a report in a headless Chromium: two pictures, recorded images, tiles, near light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig import MAX_PIXELS
from sgp.report import FolderMaps, embed, make_report, read_folder
from sgp.report import planes as planes_module
from sgp.report import report as report_module
from tests.sgp.chromium import MISSING, PROGRAM, WINDOW, Browser
from tests.sgp.report_folder import (
    frame_level,
    light_vector,
    shaded,
    write_folder,
    write_recording,
)
from tests.sgp.test_report_page import FRAME, at_map, opened, pixels, quiet, show

pytestmark = [pytest.mark.slow, pytest.mark.skipif(PROGRAM is None, reason=MISSING)]
STATUS = "document.querySelector('.status').textContent"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("views")
    source = write_recording(path / "frames")
    return write_folder(path / "ball", inputs=sorted(source.iterdir()), source=str(source))


@pytest.fixture(scope="module")
def planes(folder):
    return embed(FolderMaps(read_folder(folder), MAX_PIXELS), 1e6).planes


@pytest.fixture(scope="module")
def page(folder) -> Path:
    path = folder.parent / "ball.html"
    path.write_text(make_report([folder], max_pixels=MAX_PIXELS).html, encoding="utf-8")
    return path


def halves(canvas: np.ndarray, size: tuple[int, int]) -> list[np.ndarray]:
    """Cut the two maps out of a canvas with two pictures."""
    rows, columns = canvas.shape[:2]
    gap = max(2, round(max(rows, columns) / 250))
    if rows > columns:
        half = (rows - gap) // 2
        parts = [canvas[:half], canvas[-half:]]
    else:
        half = (columns - gap) // 2
        parts = [canvas[:, :half], canvas[:, -half:]]
    return [at_map(part, size) for part in parts]


def slide(browser: Browser, label: str, value: float) -> None:
    browser.value(
        "(() => { const one = [...document.querySelectorAll('.slider')]"
        f".find((row) => row.textContent.startsWith('{label}')).querySelector('input');"
        f"one.value = {value}; one.dispatchEvent(new Event('input')); }})()"
    )


@pytest.mark.parametrize("window", [(1280, 800), (390, 844)])
def test_two_pictures_share_light_and_place(browser, page, planes, window):
    browser.resize(*window, mobile=window[0] < 500)
    try:
        opened(browser, page, "#layout=side")
        browser.value("location.hash = 'layout=side&zoom=1&show=matte&right=normals&light=80,30'")
        browser.until("document.querySelector('canvas').dataset.shown === 'matte normals'")
        browser.value(FRAME)
        size = planes["normals"].samples.shape[:2]
        for found, mode in zip(halves(pixels(browser), size), ("matte", "normals"), strict=True):
            assert np.abs(found[..., :3] - shaded(planes, mode, (80, 30))).max() <= 2
        # Keys move, zoom and light both.
        browser.value("document.querySelector('canvas').focus()")
        for key, shift in (("+", False), ("ArrowLeft", True), ("ArrowLeft", False)):
            browser.press(key, shift=shift)
        browser.value(FRAME)
        first, second = (part[..., 3] for part in halves(pixels(browser), size))
        assert 0 < first.mean() < 255
        np.testing.assert_array_equal(first, second)
        assert browser.value(STATUS).startswith("Light: azimuth 85°, elevation 30°")
        quiet(browser, page)
    finally:
        browser.resize(*WINDOW)


def test_dragging_in_the_second_picture_turns_the_light_about_its_middle(browser, page):
    opened(browser, page, "#layout=side&show=matte&right=normals")
    left, top, wide, high = browser.value(
        "(({x, y, width, height}) => [x, y, width, height])"
        "(document.querySelector('canvas').getBoundingClientRect())"
    )
    half = wide / 2
    middle = (left + 1.5 * half + 1, top + high / 2)
    browser.drag(middle, (middle[0], middle[1] - 0.25 * high))
    browser.value(FRAME)
    # The cosine of the elevation is half of the half height.
    assert browser.value(STATUS).startswith("Light: azimuth 90°, elevation 60°")


def weights(azimuth: float, elevation: float, count: int = 8) -> dict[int, float]:
    """Shares of the three nearest images, each by its closeness beyond that of the fourth."""
    light = light_vector(azimuth, elevation)
    ring = np.array([light_vector(360 * number / count, 45) for number in range(count)])
    away = np.linalg.norm(ring - light, axis=1) + 1e-6
    order = np.argsort(away, kind="stable")[:4]
    shares = 1 / away[order[:3]] - 1 / away[order[3]]
    return dict(zip(order[:3].tolist(), (shares / shares.sum()).tolist(), strict=True))


@pytest.mark.parametrize("light", [(0, 45), (90, 45), (30, 45), (160, 60), (350, 20)])
def test_recorded_images_fade_into_each_other_with_the_light(browser, page, light):
    opened(browser, page)
    found = show(browser, "captured", light)[..., :3]
    rows, columns = found.shape[:2]
    middle = found[rows // 2, columns // 2].astype(float)
    white = frame_level(7)
    shares = weights(*light)
    # Each image is embedded in 8 bits; they are mixed in linear light.
    mixed = sum(share * frame_level(number) / white for number, share in shares.items())
    expected = 255 * (1.055 * mixed ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(middle, expected, atol=2)
    nearest = max(shares, key=shares.__getitem__)
    assert f"image L{nearest} {100 * shares[nearest]:.0f} %" in browser.value(STATUS)


@pytest.mark.parametrize("light", [(135, 45), (20, 15)])
def test_a_near_light_equals_numpy(browser, page, planes, light):
    opened(browser, page)
    browser.value(
        "[...document.querySelectorAll('input[type=checkbox]')]"
        ".find((one) => one.parentElement.textContent.includes('near light')).click()"
    )
    size = planes["normals"].samples.shape[:2]
    for mode in ("shaded", "matte", "specular"):
        found = at_map(show(browser, mode, light), size)[..., :3]
        assert np.abs(found - shaded(planes, mode, light, near=True)).max() <= 2, mode


@pytest.mark.parametrize("sigma", [1, 3])
def test_smoothed_normals_equal_numpy(browser, page, planes, sigma):
    opened(browser, page)
    slide(browser, "Smoothing", sigma)
    browser.value("new Promise((done) => setTimeout(done, 400))")
    size = planes["normals"].samples.shape[:2]
    for mode in ("matte", "normals"):
        found = at_map(show(browser, mode, (135, 45)), size)[..., :3]
        expected = shaded(planes, mode, (135, 45), smoothing=sigma)
        assert np.abs(found - expected).max() <= 2, mode


def test_tiles_show_every_pixel_of_the_maps(browser, folder, planes, monkeypatch):
    rows, columns = planes["normals"].samples.shape[:2]
    monkeypatch.setattr(report_module, "_PIXELS", rows * columns / 4)
    monkeypatch.setattr(report_module, "SIDE", 32)
    monkeypatch.setattr(planes_module, "SIDE", 32)
    made = make_report([folder], max_pixels=MAX_PIXELS, full=True)
    assert made.reduction == [1.0]
    path = folder.parent / "full.html"
    path.write_text(made.html, encoding="utf-8")
    opened(browser, path)
    for mode in ("shaded", "normals", "detail"):
        show(browser, mode, (80, 30))
        browser.until("document.querySelector('canvas').dataset.pending === '0'")
        browser.value(FRAME)
        found = at_map(pixels(browser), (rows, columns))[..., :3]
        assert np.abs(found - shaded(planes, mode, (80, 30))).max() <= 2, mode
    quiet(browser, path)


def test_invented_pixels_are_marked_until_the_mark_is_switched_off(browser, folder):
    before = folder.parent / "ball"
    after = write_folder(
        folder.parent / "filled",
        command="sgp detail fill",
        invented=True,
        inputs=[before / "normals.exr"],
        normals=str(before / "normals.exr"),
    )
    path = folder.parent / "filled.html"
    path.write_text(make_report([after], max_pixels=MAX_PIXELS).html, encoding="utf-8")
    opened(browser, path, "#layout=side&zoom=1&show=matte&right=matte")
    browser.value(FRAME)
    size = embed(FolderMaps(read_folder(after), MAX_PIXELS), 1e6).size
    first, second = halves(pixels(browser), size)
    marked = (first[..., 0].astype(int) - first[..., 2]) > 60
    assert 0.15 < marked.sum() / (0.08 * 50**2) < 0.5  # stripes are 3 of 10 pixels wide
    assert not ((second[..., 0].astype(int) - second[..., 2]) > 60).any()
    browser.value(
        "[...document.querySelectorAll('input[type=checkbox]')]"
        ".find((one) => one.parentElement.textContent.includes('invented')).click()"
    )
    browser.value(FRAME)
    first, _ = halves(pixels(browser), size)
    assert not ((first[..., 0].astype(int) - first[..., 2]) > 60).any()


def box_of(browser: Browser, selector: str) -> tuple[float, float, float, float]:
    """Scroll an element into the window; return its middle and its size."""
    return tuple(
        browser.value(
            f"((one) => {{ one.scrollIntoView({{block: 'center'}});"
            " const {x, y, width, height} = one.getBoundingClientRect();"
            " return [x + width / 2, y + height / 2, width, height]; })"
            f"(document.querySelector('{selector}'))"
        )
    )


def test_fingers_turn_the_light_zoom_and_set_marks_on_a_phone(browser, page):
    browser.resize(390, 844, mobile=True)
    browser.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    try:
        opened(browser, page)
        x, y, _, high = box_of(browser, ".stage canvas")
        browser.touch([(x, y), (x, y - 0.1 * high), (x, y - 0.25 * high)])
        browser.value(FRAME)
        # The cosine of the elevation is half of the half height.
        assert browser.value(STATUS) == "Light: azimuth 90°, elevation 60°"
        zoomed = "document.querySelector('.zoomed').textContent"
        before = float(browser.value(zoomed).split()[0])
        browser.touch([(x - 30, y), (x - 60, y)], [(x + 30, y), (x + 60, y)])
        browser.value(FRAME)
        assert float(browser.value(zoomed).split()[0]) == pytest.approx(2 * before, abs=1)
        # The first finger of two has turned the light to the place where it lay.
        x, y, wide, _ = box_of(browser, "svg.dome")
        browser.touch([(x, y), (x + 0.225 * wide, y)])
        assert browser.value(STATUS) == "Light: azimuth 0°, elevation 60°"
        small = browser.value(
            "[...document.querySelectorAll('button, select, input')]"
            ".filter((one) => one.offsetParent && one.type !== 'checkbox' && one.type !== 'range')"
            ".filter((one) => one.getBoundingClientRect().height < 24).length"
        )
        assert small == 0

        browser.value("document.querySelector('#view-surface3d-tab').click()")
        browser.until("Number(document.querySelector('canvas.surface')?.dataset.drawn ?? 0) > 0")
        x, y, *_ = box_of(browser, "canvas.surface")
        picture = "document.querySelector('canvas.surface').toDataURL()"
        before = browser.value(picture)
        browser.touch([(x, y), (x + 20, y), (x + 60, y)])
        browser.value(FRAME)
        assert browser.value(picture) != before
        browser.value("document.querySelector('[data-kind=point]').click()")
        x, y, *_ = box_of(browser, "canvas.surface")
        browser.touch([(x, y)])
        browser.until("document.querySelectorAll('section.mark').length === 1")
        assert browser.value("document.documentElement.scrollWidth") <= 390
        quiet(browser, page)
    finally:
        browser.call("Emulation.setTouchEmulationEnabled", enabled=False)
        browser.resize(*WINDOW)


def test_a_glossy_result_without_albedo_is_white(browser, tmp_path):
    folder = write_folder(tmp_path / "ball")
    (folder / "albedo.png").unlink()
    planes = embed(FolderMaps(read_folder(folder), MAX_PIXELS), 1e6).planes
    page = tmp_path / "page.html"
    page.write_text(make_report([folder], max_pixels=MAX_PIXELS).html, encoding="utf-8")
    opened(browser, page)
    size = planes["normals"].samples.shape[:2]
    found = at_map(show(browser, "specular", (60, 40)), size)[..., :3]
    expected = shaded(planes, "specular", (60, 40))
    assert expected.max() > 200
    assert np.abs(found - expected).max() <= 2
    quiet(browser, page)


FOLDED = "document.querySelectorAll('details:not([open])').length"


def test_a_printed_page_is_on_white_paper_and_has_all_tables(browser, page):
    opened(browser, page)
    folded = browser.value(FOLDED)
    assert folded > 3
    browser.value(f"window.addEventListener('beforeprint', () => (window.left = {FOLDED}))")
    browser.call("Page.printToPDF")
    assert browser.value("window.left") == 0
    assert browser.value(FOLDED) == folded
    try:
        browser.resize(794, 1100, dark=True)
        scheme = {"name": "prefers-color-scheme", "value": "dark"}
        browser.call("Emulation.setEmulatedMedia", media="print", features=[scheme])
        browser.value(FRAME)
        colours = "(({color, backgroundColor}) => [color, backgroundColor])"
        assert browser.value(f"{colours}(getComputedStyle(document.body))") == [
            "rgb(0, 0, 0)",
            "rgb(255, 255, 255)",
        ]
        seen = "one.getClientRects().length > 0"
        for selector, count in {".prerendered img": 8, ".contact img": 8, ".controls": 0}.items():
            elements = f"[...document.querySelectorAll('{selector}')]"
            assert browser.value(f"{elements}.filter((one) => {seen}).length") == count, selector
        assert browser.value("document.documentElement.scrollWidth") <= 794
    finally:
        browser.call("Emulation.setEmulatedMedia", media="")
        browser.resize(*WINDOW)
    quiet(browser, page)


TEXTS = """(() => {
  const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const luminance = (colour) => {
    const part = (c) => (c <= 10 ? c / 3294 : ((c / 255 + 0.055) / 1.055) ** 2.4);
    const [r, g, b] = numbers(colour).map(part);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (one) => {
    for (let at = one; at; at = at.parentElement) {
      const colour = getComputedStyle(at).backgroundColor;
      if ((numbers(colour)[3] ?? 1) > 0.5) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const found = [];
  for (const one of document.querySelectorAll("body *")) {
    const own = [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
    if (!own || one.getClientRects().length === 0 || one.closest("script")) continue;
    const style = getComputedStyle(one);
    const matrix = one.ownerSVGElement?.getScreenCTM();
    const size = parseFloat(style.fontSize) * (matrix ? Math.hypot(matrix.a, matrix.b) : 1);
    const [a, b] = [luminance(matrix ? style.fill : style.color), luminance(behind(one))];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    found.push([one.textContent.trim().slice(0, 40), size, contrast]);
  }
  return found;
})()"""


def test_texts_are_large_and_dark_enough(browser, page):
    opened(browser, page)
    try:
        for width, height in ((1280, 800), (390, 844)):
            for dark in (False, True):
                browser.resize(width, height, mobile=width < 800, dark=dark)
                browser.value(FRAME)
                texts = browser.value(TEXTS)
                assert len(texts) > 60
                assert [one for one in texts if one[1] < 10.5] == []
                assert [one for one in texts if one[2] < 4.5] == []
    finally:
        browser.resize(*WINDOW)


def test_an_address_of_the_open_page_chooses_the_view(browser, page):
    opened(browser, page)
    for view in ("surface3d", "relight"):
        browser.value(f"location.hash = 'view={view}'")
        browser.until(f"!document.getElementById('view-{view}').hidden")
    quiet(browser, page)
