"""The 3D view of a report in a headless Chromium: silhouette, measuring, marks."""

from __future__ import annotations

import base64
import csv
import json
import time
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import binary_dilation, binary_erosion

from acquisition import read_image, write_exr
from sgp.app import build, run
from tests.sgp.chromium import MISSING, PROGRAM, Browser
from tests.sgp.report_folder import PIXEL_MM, write_folder
from tests.sgp.test_report_page import FRAME, PIXELS, quiet

pytestmark = [pytest.mark.slow, pytest.mark.skipif(PROGRAM is None, reason=MISSING)]

VIEW = "document.querySelector('#view-surface3d')"
CANVAS = "document.querySelector('canvas.surface')"
SURFACE_PIXELS = PIXELS.replace('document.querySelector("canvas")', CANVAS)
WITHOUT_WEBGL = """(() => {
  const {getContext} = HTMLCanvasElement.prototype;
  HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
    return kind === "2d" ? getContext.call(this, kind, ...rest) : null;
  };
})()"""
TOP_LEFT = np.s_[:40, :40]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A ball whose upper left corner has no height, so that no two sides look the same."""
    folder = write_folder(tmp_path_factory.mktemp("surface") / "ball")
    height = read_image(folder / "height.exr")
    height[TOP_LEFT] = np.nan
    write_exr(folder / "height.exr", height)
    return folder


@pytest.fixture(scope="module")
def page(folder) -> Path:
    path = folder.parent / "page.html"
    assert run(build(["report"]), ["report", str(folder), "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def data(folder) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places x, y, and the heights and deviations in the folder, cut as the page cuts them."""
    normals = read_image(folder / "normals.exr")
    known = np.abs(normals).max(axis=2) > 0
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    margin = 2 + max(np.ptp(rows), np.ptp(columns)) // 50
    box = tuple(
        slice(max(0, one[0] - margin), min(size, one[-1] + 1 + margin))
        for one, size in zip((rows, columns), known.shape, strict=True)
    )
    return tuple(read_image(folder / name)[box] for name in ("height.exr", "height_sigma.exr"))


def opened(browser: Browser, page: Path, fragment: str = "") -> Browser:
    browser.open(page, fragment)
    browser.until("document.querySelector('#view-surface3d-tab') !== null")
    browser.value("document.querySelector('#view-surface3d-tab').click()")
    browser.until(f"Number({CANVAS}?.dataset.drawn ?? 0) > 0")
    browser.value(FRAME)
    return browser


def press(browser: Browser, text: str) -> None:
    """Press the first button of the view with this text, and wait for the picture."""
    browser.value(
        f"[...{VIEW}.querySelectorAll('button')]"
        f".find((one) => one.textContent === '{text}').click()"
    )
    browser.value(FRAME)


def typed(browser: Browser, *places: tuple[float, float]) -> None:
    for x, y in places:
        browser.value(
            f"(([x, y]) => {{ x.value = {x}; y.value = {y}; }})"
            f"({VIEW}.querySelectorAll('.typed input'))"
        )
        press(browser, "Set")


def saved(browser: Browser, tmp_path: Path, button: str, name: str) -> str:
    """Press a button that saves a file, and return its text."""
    browser.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    press(browser, button)
    path = tmp_path / name
    until = time.monotonic() + 20
    while not path.exists():
        assert time.monotonic() < until, sorted(tmp_path.iterdir())
        browser.value("1")
        time.sleep(0.05)
    text = path.read_text(encoding="utf-8")
    path.unlink()
    return text


def figures(browser: Browser, tmp_path: Path) -> list[dict[str, Any]]:
    text = saved(browser, tmp_path, "Save annotations", "ball-annotations.json")
    return [mark["figures"] for mark in json.loads(text)["marks"]]


def interpolated(values: np.ndarray) -> RegularGridInterpolator:
    """Return a function of y and x."""
    rows, columns = values.shape
    y = (np.arange(rows) - (rows - 1) / 2) * PIXEL_MM
    x = (np.arange(columns) - (columns - 1) / 2) * PIXEL_MM
    return RegularGridInterpolator((y, x), values[::-1])


def scale_bar(browser: Browser) -> float:
    """Return the pixels of a millimetre by the scale bar."""
    text = browser.value("[...document.querySelectorAll('.overlay text')].at(-1).textContent")
    wide = browser.value("document.querySelector('.overlay .ruler').getBBox().width")
    assert text.endswith(" mm")
    return wide / float(text.split()[0])


def covered(browser: Browser) -> np.ndarray:
    width, height, text = browser.value(SURFACE_PIXELS)
    return (
        np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)[::-1, :, 3] > 127
    )


def seen(heights: np.ndarray, turn_deg: float, shape: tuple[int, int], scale: float) -> np.ndarray:
    """Return where points of the surface are in a picture, from a camera turned to the left."""
    rows, columns = heights.shape
    fine = 4
    v, u = np.mgrid[0 : rows - 1 : 1 / fine, 0 : columns - 1 : 1 / fine]
    y, x = ((rows - 1) / 2 - v) * PIXEL_MM, (u - (columns - 1) / 2) * PIXEL_MM
    z = interpolated(heights)((y, x)) - (np.nanmax(heights) + np.nanmin(heights)) / 2
    turn = np.radians(turn_deg)
    across = x * np.cos(turn) + z * np.sin(turn)
    at = np.isfinite(z)
    places = np.stack([shape[0] / 2 - scale * y[at], shape[1] / 2 + scale * across[at]])
    picture = np.zeros(shape, bool)
    picture[tuple(np.clip(np.floor(places).astype(int), 0, np.array(shape)[:, None] - 1))] = True
    return picture


@pytest.mark.parametrize("turns", [0, 6])
def test_the_silhouette_is_that_of_the_projected_heights(browser, page, data, turns):
    opened(browser, page)
    press(browser, "Front")
    browser.value(f"{CANVAS}.focus()")
    for _ in range(turns):
        browser.press("ArrowLeft")
    browser.value(FRAME)
    found, scale = covered(browser), scale_bar(browser)
    expected = seen(data[0], 5 * turns, found.shape, scale)
    pixel = int(np.ceil(PIXEL_MM * scale)) + 1
    reach = np.ones((2 * pixel + 1,) * 2)
    assert 0.1 < found.mean() < 0.9
    # One pixel of the map at most lies between both outlines.
    assert not (found & ~binary_dilation(expected, reach)).any()
    closed = binary_erosion(binary_dilation(expected, reach), reach)
    assert not (binary_erosion(closed, reach) & ~found).any()
    quiet(browser, page)


def test_figures_of_typed_places_are_those_of_the_data(browser, page, data, tmp_path):
    height, sigma = (interpolated(values) for values in data)
    opened(browser, page)
    pairs = [((-3.0, -2.0), (4.1, 1.23)), ((0.0, 6.0), (0.0, -6.0)), ((5.0, 0.05), (5.3, 0.05))]
    press(browser, "Distance")
    for pair in pairs:
        typed(browser, *pair)
    press(browser, "Point")
    typed(browser, (1.5, 2.5))
    *found, point = figures(browser, tmp_path)
    for (a, b), figure in zip(pairs, found, strict=True):
        across = np.hypot(b[0] - a[0], b[1] - a[1])
        z = [float(height(end[::-1])) for end in (a, b)]
        s = [float(sigma(end[::-1])) for end in (a, b)]
        assert figure["difference"] == pytest.approx(z[1] - z[0], rel=1e-3, abs=2e-4)
        assert figure["distance"] == pytest.approx(np.hypot(across, z[1] - z[0]), rel=1e-3)
        assert figure["across"] == pytest.approx(across)
        assert figure["differenceSigma"] == pytest.approx(np.hypot(*s), rel=2e-2)
    assert point["height"] == pytest.approx(float(height((2.5, 1.5))), rel=1e-3)
    shown = browser.value(f"{VIEW}.querySelector('.mark dl').textContent")
    assert f"Distance{found[0]['distance']:.5g} mm" in shown
    quiet(browser, page)


def test_a_profile_equals_the_data(browser, page, data, tmp_path):
    opened(browser, page)
    press(browser, "Distance")
    a, b = np.array([-7.0, -1.0]), np.array([7.0, 3.0])
    typed(browser, a, b)
    rows = list(
        csv.DictReader(saved(browser, tmp_path, "Save profile", "ball-profile.csv").splitlines())
    )
    across, found, sigma = (
        np.array([float(row[f"{name}_mm"]) for row in rows])
        for name in ("distance", "height", "sigma")
    )
    length = np.linalg.norm(b - a)
    assert across[[0, -1]] == pytest.approx([0, length])
    assert np.diff(across).max() <= PIXEL_MM
    places = (a + np.outer(across / length, b - a))[:, ::-1]
    assert found == pytest.approx(interpolated(data[0])(places), rel=1e-3)
    # Deviations have 8 bits.
    assert sigma == pytest.approx(
        interpolated(data[1])(places), abs=float(np.nanmax(data[1])) / 250
    )
    band, line = (
        browser.value(f"{VIEW}.querySelector('.profile .{name}').getBBox().height")
        for name in ("band", "line")
    )
    assert band > line > 100


def test_clicks_set_marks_where_they_are(browser, page):
    opened(browser, page)
    press(browser, "Front")
    press(browser, "Distance")
    scale = scale_bar(browser)
    box = browser.value(
        f"(({{x, y, width, height}}) => [x + width / 2, y + height / 2])"
        f"({CANVAS}.getBoundingClientRect())"
    )
    wanted = [(-2.0, 1.0), (3.0, -4.0)]
    # A drag turns the surface and sets no mark; the outer corner has no surface.
    for x, y in [(-8.0, 8.0), *wanted]:
        place = box[0] + scale * x, box[1] - scale * y
        browser.drag(place, place, steps=1)
        browser.value(FRAME)
        if x == -8.0:
            hint = browser.value(f"{VIEW}.querySelector('.hint').textContent")
            assert hint == "There is no surface at this place."
    points = json.loads(
        browser.value("new URLSearchParams(location.hash.slice(1)).get('marks-0')")
    )[0]["points"]
    assert np.abs(np.array(points) - wanted).max() < 1.5 / scale
    before = covered(browser)
    browser.drag((box[0], box[1]), (box[0] + 150, box[1] + 40))
    browser.value(FRAME)
    assert (covered(browser) != before).mean() > 0.01
    assert browser.value(f"{VIEW}.querySelectorAll('.mark dl').length") == 1
    quiet(browser, page)


def test_marks_survive_a_reload_and_a_file(browser, page, tmp_path):
    hostile = "<img src=x onerror='window.hit=1'> & \"#%\u202e"
    opened(browser, page)
    press(browser, "Area")
    typed(browser, (0, 0), (3, 0), (3, 2), (0, 2))
    press(browser, "Done")
    browser.value(
        f"((one) => {{ one.value = {json.dumps(hostile)};"
        f" one.dispatchEvent(new Event('input')); }})({VIEW}.querySelector('.mark input'))"
    )
    press(browser, "Point")
    typed(browser, (1.25, -2))
    first = saved(browser, tmp_path, "Save annotations", "ball-annotations.json")
    assert [mark["text"] for mark in json.loads(first)["marks"]] == [hostile, ""]
    fragment = browser.value("location.hash")
    browser.open(page.parent / "ball" / "albedo.png")
    assert "view=surface3d" in fragment
    browser.open(page, fragment)
    browser.until(f"Number({CANVAS}?.dataset.drawn ?? 0) > 0")
    assert saved(browser, tmp_path, "Save annotations", "ball-annotations.json") == first
    browser.value("location.hash = ''")
    browser.until(f"{VIEW}.querySelectorAll('.mark dl').length === 0")
    hint = f"{VIEW}.querySelector('.hint').textContent"
    other = json.loads(first)
    cases = {
        "{": "is not a JSON file",
        "[]": "is not a file of annotations",
        json.dumps(other | {"version": 2}): "has version 2; this page reads version 1",
        json.dumps(other | {"unit": "px"}): "has lengths in px, and this result in mm",
        json.dumps(other | {"marks": {}}): "has no list of marks",
        json.dumps(other | {"marks": [{"points": []}]}): "mark 1 has no list of points [x, y]",
        json.dumps(other | {"marks": [{"points": [[1, "2"]]}]}): "mark 1 has no list of points",
        json.dumps(other | {"marks": other["marks"] * 101}): "has more than 200 marks",
        first: "Places have x to the right",
    }
    for number, (text, expected) in enumerate(cases.items()):
        path = tmp_path / f"file{number}.json"
        path.write_text(text, encoding="utf-8")
        load(browser, path)
        browser.until(f"{hint}.includes({json.dumps(expected)})")
    assert saved(browser, tmp_path, "Save annotations", "ball-annotations.json") == first
    assert browser.value("window.hit ?? 0") == 0
    quiet(browser, page)


def load(browser: Browser, path: Path) -> None:
    document = browser.call("DOM.getDocument")["root"]["nodeId"]
    node = browser.call("DOM.querySelector", nodeId=document, selector="input[type=file]")["nodeId"]
    browser.call("DOM.setFileInputFiles", nodeId=node, files=[str(path)])


def test_a_damaged_address_sets_no_marks(browser, page):
    for text in ("[[", '[{"points": [[1]]}]', '{"a": 1}', '[{"points": [[NaN, 1]]}]', "null"):
        opened(browser, page, f"#marks-0={quote(text)}")
        assert browser.value(f"{VIEW}.querySelectorAll('section.mark').length") == 0
    far = quote(json.dumps([{"points": [[1e9, 0], [0, 0]], "text": "far"}]))
    opened(browser, page, f"#marks-0={far}")
    assert "off the surface" in browser.value(f"{VIEW}.querySelector('section.mark').textContent")
    quiet(browser, page)


def test_the_keyboard_reaches_the_controls_and_turns(browser, page):
    opened(browser, page)
    wanted = browser.value(
        f"[...{VIEW}.querySelectorAll('button, select, input, [tabindex]')]"
        ".filter((one) => one.tabIndex >= 0 && !one.disabled && !one.hidden"
        " && (one.offsetParent !== null || one.matches('svg'))).length"
    )
    names = set()
    browser.value("document.querySelector('#view-surface3d-tab').focus()")
    for _ in range(wanted):
        browser.press("Tab")
        inside, outline, name = browser.value(
            f"((one) => [{VIEW}.contains(one), getComputedStyle(one).outlineStyle,"
            " one.getAttribute('aria-label') ?? (one.labels?.[0] ?? one).textContent])"
            "(document.activeElement)"
        )
        assert inside
        assert outline != "none", name
        names.add(name.strip())
    assert len(names) == wanted > 12
    assert all(names)
    quiet(browser, page)


GRID = """(() => {
  const [columns, rows, pixelSize] = [%d, %d, %g];
  const height = new Float32Array(columns * rows);
  const half = [(columns - 1) / 2 * pixelSize, (rows - 1) / 2 * pixelSize];
  for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
    const [x, y] = [j * pixelSize - half[0], half[1] - i * pixelSize];
    height[i * columns + j] = %s;
  }
  const [differences, camera, jumps] = [%s];
  const data = {columns, rows, pixelSize, unit: "mm", height, sigma: null, camera, jumps};
  const heights = new $js_surface_heights.Heights(data, differences);
  return (%s)(heights);
})()"""


def measured(browser: Browser, expression: str, points: list, differences: str = "null") -> Any:
    code = f"(heights) => $js_surface_measure.measured(heights, {json.dumps(points)})"
    return browser.value(GRID % (60, 50, 0.5, expression, differences, code))


def test_areas_are_those_of_planes_and_spheres(browser, page):
    opened(browser, page)
    triangle = [(-10.0, -8.0), (9.0, -7.0), (1.3, 9.1)]
    a, b, c = np.array(triangle)
    seen_area = abs(np.linalg.det([b - a, c - a])) / 2
    plane = measured(browser, "0.75 * x - 0.5 * y", triangle)
    assert plane["area"] == pytest.approx(seen_area)
    assert plane["surface"] == pytest.approx(seen_area * np.sqrt(1 + 0.75**2 + 0.5**2), rel=1e-4)
    # The cap of a sphere of radius 20 over a circle of radius 10.
    around = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    circle = (10 * np.stack([np.cos(around), np.sin(around)], 1)).tolist()
    cap = measured(browser, "Math.sqrt(400 - x * x - y * y)", circle)
    expected = 2 * np.pi * 20 * (20 - np.sqrt(300))
    assert cap["surface"] == pytest.approx(expected, rel=2e-3)
    crossed = measured(browser, "0", [(0, 0), (4, 4), (4, 0), (0, 4)])
    assert crossed["crossing"]
    half = measured(browser, "x > 0 ? NaN : 0", [(-5, -5), (5, -5), (5, 5), (-5, 5)])
    assert half["missing"] == pytest.approx(0.5, abs=0.06)


def test_deviations_of_differences_are_those_of_the_record(browser, page):
    opened(browser, page)
    recorded = "{distances: [1, 2, 10], sigma: [0.1, 0.2, 0.4]}"
    for across, expected in ((0.5, 0.05), (1, 0.1), (1.5, 0.15), (6, 0.3), (13, 0.4)):
        found = measured(browser, "x", [(0, 0), (across, 0)], recorded)
        assert found["differenceSigma"] == pytest.approx(expected), across


def test_a_section_lies_in_its_plane_and_on_the_surface(browser, page):
    opened(browser, page)
    code = (
        "(heights) => { const mesh = $js_surface_mesh.meshOf(heights, 1e6);"
        " return $js_surface_mesh.section(mesh, %d, %g - (%d === 2 ? mesh.middle : 0))"
        ".map((v, i) => v + (i %% 3 === 2 ? mesh.middle : 0)); }"
    )
    ball = "Math.sqrt(900 - x * x - y * y)"
    for axis, value in ((0, 3.1), (1, -2.2), (2, 28.0)):
        code_here = code % (axis, value, axis)
        segments = np.array(browser.value(GRID % (60, 50, 0.5, ball, "null", code_here)))
        points = segments.reshape(-1, 3)
        assert points[:, axis] == pytest.approx(value, abs=1e-4)
        assert np.linalg.norm(points, axis=1) == pytest.approx(30, rel=1e-3)
        length = np.linalg.norm(np.diff(segments.reshape(-1, 2, 3), axis=1), axis=2).sum()
        if axis == 2:
            assert length == pytest.approx(2 * np.pi * np.sqrt(900 - 28**2), rel=5e-3)


def test_a_large_map_is_reduced_for_the_picture_only(browser, page):
    opened(browser, page)
    code = (
        "(heights) => { const mesh = $js_surface_mesh.meshOf(heights, 1000);"
        " return [mesh.step, mesh.positions.length / 3, heights.at(0.25, 0.25)]; }"
    )
    step, vertices, height = browser.value(GRID % (60, 50, 0.5, "x + 2 * y", "null", code))
    assert (step, vertices) == (2, 750)
    assert height == pytest.approx(0.75)


def test_without_webgl_the_view_says_so(browser, page):
    text = "This view cannot be shown: the browser has no WebGL2."
    browser.open(page)
    browser.until("document.querySelector('#view-surface3d-tab') !== null")
    browser.value(WITHOUT_WEBGL)
    browser.value("document.querySelector('#view-surface3d-tab').click()")
    browser.until(f"{VIEW}.textContent.includes({json.dumps(text)})")
    quiet(browser, page)


def test_figures_follow_the_lines_of_sight_of_a_camera(browser, page):
    """Against points of a plane and of a sphere on the rays of a camera at 40 mm."""
    opened(browser, page)
    camera = 40.0, np.array([3.0, -2.0])

    def point(x, y, z):
        return np.array([*(camera[1] + (np.array([x, y]) - camera[1]) * (1 - z / camera[0])), z])

    extra = "null, {distance: 40, axis: [3, -2]}"
    ends = [(-9.0, 4.0), (8.0, -7.0)]
    a, b = (point(x, y, 0.3 * x - 0.2 * y + 1) for x, y in ends)
    found = measured(browser, "0.3 * x - 0.2 * y + 1", ends, extra)
    assert found["distance"] == pytest.approx(np.linalg.norm(b - a), rel=1e-4)
    assert found["across"] == pytest.approx(np.linalg.norm((b - a)[:2]), rel=1e-4)
    # A plane of the map is a bent surface; a level stays one, and is seen smaller.
    polygon = [(-5, -5), (5, -5), (5, 5), (-5, 5)]
    level = measured(browser, "8", polygon, extra)
    assert [level["area"], level["surface"]] == pytest.approx([100 * 0.8**2] * 2, rel=1e-4)
    # The sphere of radius 12 around 0, along the ray of each place.
    w = "((x - 3) ** 2 + (y + 2) ** 2) / 1600"
    p = "((3 * (x - 3) - 2 * (y + 2)) / 40)"
    # |axis + ray t| = 12 with z = 40 (1 - t): (w + 1) 1600 t² + 2 (40 p - 1600) t + ...
    z = (
        f"((w, p) => {{ const [a, b, c] = [1600 * (w + 1), 40 * p - 1600, 1600 + 13 - 144];"
        f" return 40 * (1 - (-b - Math.sqrt(b * b - a * c)) / a); }})({w}, {p})"
    )
    around = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = (4 * np.stack([np.cos(around), np.sin(around)], 1)).tolist()
    cap = measured(browser, z, circle, extra)
    grid = np.stack(np.meshgrid(*[np.linspace(-4, 4, 801)] * 2), -1)
    x, y = np.moveaxis(grid, -1, 0)
    at = np.hypot(x, y) < 4
    ray = np.stack([x - 3, y + 2, np.full_like(x, -40.0)], -1)
    origin = np.array([3.0, -2.0, 40.0])
    a2, b2 = (ray**2).sum(-1), ray @ origin
    t = (-b2 - np.sqrt(b2**2 - a2 * (origin @ origin - 144))) / a2
    points = origin + ray * t[..., None]
    du, dv = np.gradient(points, axis=(0, 1))
    expected = np.linalg.norm(np.cross(du, dv), axis=-1)[at].sum()
    assert cap["surface"] == pytest.approx(expected, rel=5e-3)


def test_nothing_spans_a_jump(browser, page):
    """A step between columns 29 and 30, and one pixel that hangs on nothing."""
    opened(browser, page)
    jumps = np.zeros((50, 60), int)
    jumps[:, 29] = 1
    jumps[20, 9], jumps[20, 10], jumps[19, 10] = 1, 3, 2
    code = """(heights) => {
      const step = $js_surface_mesh.meshOf(heights, %g);
      let widest = 0;
      for (let t = 0; t < step.index.length; t += 3) {
        const z = [0, 1, 2].map((k) => step.positions[3 * step.index[t + k] + 2]);
        widest = Math.max(widest, Math.max(...z) - Math.min(...z));
      }
      const across = [0.24, -0.24, 0.01].map((x) => heights.at(x, 3));
      return [widest, step.index.length / 3, ...across];
    }"""
    height = "(x > 0 ? 7 : 0) + (Math.abs(x + 9.75) < 0.1 && Math.abs(y - 2.25) < 0.1 ? 3 : 0)"
    extra = f"null, null, {json.dumps(jumps.ravel().tolist())}"
    for most, count in ((1e6, 2 * 49 * 58 - 4), (1000, 2 * 24 * 28 - 4)):
        widest, triangles, *heights = browser.value(
            GRID % (60, 50, 0.5, height, extra, code % most)
        )
        assert (widest, triangles) == (0, count)
        assert heights == [7, 0, 7]
    area = measured(browser, height, [(-5, -5), (5, -5), (5, 5), (-5, 5)], extra)
    assert area["surface"] == pytest.approx(95, rel=1e-3)
    assert area["missing"] == pytest.approx(0.05, abs=1e-6)
