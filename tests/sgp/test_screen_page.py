"""The operator's page in a headless Chromium: light, picture, keyboard, layout, recording."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import Session, verify_session
from acquisition.preview.live_picture import CLIPPED
from sgp.screen import station
from sgp.screen.access import private_link
from sgp.screen.station import Light
from tests.cases import cases
from tests.sgp.chromium import MISSING, PROGRAM, WINDOW, Browser
from tests.sgp.screen_rig import LitRig, Served, served, until

pytestmark = pytest.mark.skipif(PROGRAM is None, reason=MISSING)

FRAME = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
PIXELS = """(() => {
  const canvas = document.querySelector("#view");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let text = "";
  for (let i = 0; i < data.length; i += 8192)
    text += String.fromCharCode(...data.subarray(i, i + 8192));
  return [canvas.width, canvas.height, btoa(text)];
})()"""
DESKTOP, SMALL, TABLET = (1280, 800), (1024, 600), (820, 1180)
BRIGHT = Light("one", (0,), 40_000.0)


class Page:
    """The page of a station in the browser."""

    def __init__(self, browser: Browser, made: Served, rig: LitRig) -> None:
        self.browser, self.made, self.rig = browser, made, rig

    def open(self, *, controls: bool = True) -> None:
        self.browser.visit(self.made.address)
        self.browser.until("document.querySelector('#caption').textContent !== ''")
        if controls:
            self.browser.until("!document.querySelector('#light').disabled")

    def text(self, selector: str) -> str:
        return str(self.browser.value(f"document.querySelector({selector!r}).textContent"))

    def shows(self, selector: str, text: str) -> None:
        """Wait until an element contains a text."""
        self.browser.until(f"document.querySelector({selector!r}).textContent.includes({text!r})")

    def centre(self, element: str) -> tuple[float, float]:
        """Return the middle of an element, which is in view then."""
        x, y = self.browser.value(
            f"""(() => {{
              const element = {element};
              element.scrollIntoView({{ block: "nearest" }});
              const box = element.getBoundingClientRect();
              return [box.x + box.width / 2, box.y + box.height / 2];
            }})()"""
        )
        return x, y

    def click(self, element: str, **more: Any) -> None:
        x, y = self.centre(element)
        for kind in ("mousePressed", "mouseReleased"):
            self.browser.call(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1, **more
            )

    def press(self, label: str) -> None:
        """Click a button as soon as it is enabled."""
        self.browser.until(f"{button(label)}?.disabled === false")
        self.click(button(label))

    def record(self, name: str) -> None:
        """Record an object without the checks."""
        self.browser.until("!document.querySelector('#record .primary').disabled")
        self.browser.value("document.querySelector('#record input[type=checkbox]').checked = false")
        self.browser.value(f"document.querySelector('#record input[type=text]').value = {name!r}")
        self.press("Record")

    def tab_to(self, selector: str) -> None:
        """Press Tab until the focus is on an element."""
        for _ in range(60):
            if self.browser.value(f"document.activeElement.matches({selector!r})"):
                return
            self.browser.press("Tab")
        raise AssertionError(f"Tab does not reach {selector}")

    def picture(self) -> np.ndarray:
        """Return the part of the canvas that the frame fills, as RGB."""
        self.browser.value(FRAME)
        width, height, text = self.browser.value(PIXELS)
        rgba = np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)
        rows, columns = np.nonzero(rgba[..., 3])
        cut = rgba[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        return cut[..., :3]


def button(label: str) -> str:
    return f"[...document.querySelectorAll('button')].find((one) => one.textContent === {label!r})"


def led(number: int) -> str:
    return f"document.querySelector('.map [aria-label=\"LED {number}\"]')"


@pytest.fixture
def rig() -> Iterator[LitRig]:
    made = LitRig()
    yield made
    made.close()


@pytest.fixture
def page(browser: Browser, rig: LitRig, tmp_path: Path) -> Iterator[Page]:
    browser.resize(*DESKTOP)
    with served(rig, tmp_path / "recordings", light=BRIGHT) as made:
        page = Page(browser, made, rig)
        page.open()
        yield page
        # The tests read the canvas more often than the page.
        assert [one for one in browser.messages if "willReadFrequently" not in one] == []
        own = (made.address, "blob:", "data:", "about:")
        assert [one for one in browser.requests if not one.startswith(own)] == []
        browser.call("Page.navigate", url="about:blank")
    browser.resize(*WINDOW)
    assert made.errors == []


def test_a_click_on_an_led_turns_it_on_and_changes_the_picture(page: Page) -> None:
    before = page.picture()
    page.click(led(3))
    page.shows("#caption", "LED 3,")
    assert page.browser.value(f"{led(3)}.getAttribute('aria-pressed')") == "true"
    start_ns = time.monotonic_ns()
    time.sleep(0.2)
    assert page.rig.lit_since(start_ns) == {3}
    assert not np.array_equal(page.picture(), before)
    page.click(led(1), modifiers=8)  # with Shift
    page.shows("#caption", "LED 1,")
    page.click(led(2), modifiers=8)
    until(lambda: page.made.station.current_light == Light("cycle", (3, 1, 2), 40_000.0))
    page.press("LEDs off")
    page.shows("#caption", "all LEDs off")
    start_ns = time.monotonic_ns()
    time.sleep(0.2)
    assert page.rig.lit_since(start_ns) == set()


def test_clipped_marks_are_the_saturated_samples(page: Page) -> None:
    page.press("Pause")
    until(lambda: page.made.station.state()["live"]["paused"])
    page.press("1:1")
    page.shows("#caption", "100 %")
    frame = page.made.station.frame
    assert frame is not None
    assert 0 < frame.clipped.sum() < frame.clipped.size
    until(lambda: np.array_equal((page.picture() == CLIPPED).all(axis=2), frame.clipped))
    page.press("Clipped")  # of a picture that stands still
    page.browser.until(f"{button('Clipped')}.getAttribute('aria-pressed') === 'false'")
    until(lambda: not (page.picture() == CLIPPED).all(axis=2).any())
    shades = page.picture()[..., 0]
    assert shades[frame.clipped].min() == 255
    light, dark = np.nonzero(frame.pixels == frame.pixels.max()), frame.pixels.argmin()
    assert shades[light].min() > shades.ravel()[dark]


def test_up_is_up(page: Page) -> None:
    assert page.made.station.state()["rig"]["positions_mm"]
    heights = [y for _, y, _ in page.rig.config.led_positions_mm]
    top, bottom = int(np.argmax(heights)), int(np.argmin(heights))
    rows = [page.centre(led(number))[1] for number in (top, bottom)]
    assert rows[0] < rows[1] - 50
    means = []
    for number in (top, bottom):
        page.click(led(number))
        page.shows("#caption", f"LED {number},")
        page.press("Pause")
        time.sleep(0.4)
        upper, lower = np.array_split(page.picture().mean(axis=2), 2)
        means.append(upper.mean() - lower.mean())
    assert means[0] > means[1] + 5


def test_stop_turns_the_light_off(page: Page) -> None:
    page.press("Stop")
    page.browser.until(f"{button('Pause')}.getAttribute('aria-pressed') === 'true'")
    start_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert page.rig.lit_since(start_ns) == set()
    assert not page.browser.value("document.querySelector('#trouble').hidden === false")
    page.press("Pause")
    until(lambda: page.rig.lit_since(start_ns) == {0})


def test_the_keyboard_alone_chooses_a_light_and_records(page: Page) -> None:
    press = page.browser.press
    page.tab_to("#view")
    press("ArrowLeft")
    press("+")
    page.browser.until("!document.querySelector('#caption').textContent.includes('NaN')")
    page.tab_to(".map g")
    press("ArrowRight")
    press("ArrowRight")
    press("ArrowLeft")
    press("ArrowDown")
    press("Enter")
    page.shows("#caption", "LED 2,")
    page.tab_to("#light input")
    page.browser.call("Input.insertText", text="7")
    page.tab_to("#plan textarea")
    until(lambda: page.made.station.current_light.exposure_us != BRIGHT.exposure_us)
    page.tab_to("#record input[type=text]")
    page.browser.call("Input.insertText", text="coin 7")
    page.tab_to("#record input[type=checkbox]")
    press(" ")
    page.tab_to("#record .primary")
    press("Enter")
    page.shows("#results", "complete")
    assert verify_session(page.made.out / "coin 7").ok
    page.tab_to("#stop")
    press("Enter")
    until(lambda: page.made.station.state()["live"]["paused"])


def test_each_control_has_the_focus_once(page: Page) -> None:
    described = "document.activeElement.textContent || document.activeElement.tagName"
    found = []
    for _ in range(40):
        page.browser.press("Tab")
        found.append(page.browser.value(described))
        if found[-1] == "Stop" and len(found) > 1:
            break
    for label in (
        "Fit",
        "1:1",
        "Clipped",
        "Pause",
        "LEDs off",
        "Meter each LED",
        "Check",
        "Record",
    ):
        assert found.count(label) == 1, found
    assert found.count("0") == 1  # the LEDs are one stop; arrows go from one to the next
    assert found.count("INPUT") == 5


@pytest.mark.slow
def test_recordings_have_their_own_pictures(page: Page) -> None:
    for name in ("first", "second"):
        page.record(name)
        page.shows("#results", f"{name}: complete")
        count = len(Session.open(page.made.out / name).frames)
        page.browser.until(
            f"[...document.querySelectorAll('#thumbnails img')].filter((one) => "
            f"one.naturalWidth === 96 && one.src.includes('{name}')).length === {count}"
        )
    page.press("Normals")
    page.browser.until("document.querySelector('img.look')?.naturalWidth === 64")
    assert "second" in page.browser.value("document.querySelector('img.look').src")


@pytest.mark.slow
def test_the_plan_is_edited_and_metered(page: Page) -> None:
    page.click("document.querySelector('#plan textarea')")
    page.browser.value("document.querySelector('#plan textarea').select()")
    page.browser.call("Input.insertText", text='leds = "0-9"')
    page.shows("#plan .said", "exposures_us")
    page.browser.until("document.querySelector('#plan .said.error') !== null")
    page.browser.value("document.querySelector('#plan textarea').select()")
    page.browser.call("Input.insertText", text='leds = "0-3"\nexposures_us = [20000.0]\n')
    page.shows("#plan .said", "6 shots")
    page.press("Meter each LED")
    page.shows("#results", "4 LEDs")
    until(
        lambda: (
            "exposures_by_led"
            in page.browser.value("document.querySelector('#plan textarea').value")
        )
    )
    page.press("Check")
    page.shows("#results", "Checks")


def test_a_recording_has_the_plan_that_was_typed_just_before(page: Page) -> None:
    page.browser.until("!document.querySelector('#record .primary').disabled")
    page.browser.value("document.querySelector('#record input[type=checkbox]').checked = false")
    page.browser.value("document.querySelector('#record input[type=text]').value = 'vase'")
    page.click("document.querySelector('#plan textarea')")
    page.browser.value("document.querySelector('#plan textarea').select()")
    page.browser.call("Input.insertText", text="leds = [4]\nexposures_us = [20000.0]\n")
    page.press("Record")
    page.shows("#results", "vase: complete")
    plan = Session.open(page.made.out / "vase").manifest.plan
    assert plan is not None
    assert plan.leds == (4,)


def test_a_question_is_answered_by_the_keyboard(page: Page) -> None:
    text = 'leds = "0-3"\nexposures_us = [5000.0]\nflats = 2\n'
    page.made.desk.sheet.write(text)
    page.record("vase")
    page.browser.until("!document.querySelector('#question').hidden")
    assert "white card" in page.text("#question")
    page.browser.press("Enter")  # meant for something else
    time.sleep(0.3)
    assert page.made.station.state()["question"]
    page.browser.press("Tab")
    page.browser.press("Enter")
    page.shows("#results", "complete")
    assert page.browser.value("document.querySelector('#question').hidden")


@pytest.mark.slow
def test_another_page_only_watches_until_the_first_is_closed(page: Page) -> None:
    page.browser.call("Page.navigate", url="about:blank")
    time.sleep(0.2)
    with page.made.watched("other") as states:
        until(lambda: next(states)["controls"])
        page.open(controls=False)
        page.shows("#rig", "read only")
        for name in ("light", "plan", "stop", "record .primary"):
            assert page.browser.value(f"document.querySelector('#{name}').disabled")
        before = page.made.station.current_light
        page.click(led(2))
        time.sleep(0.2)
        assert page.made.station.current_light == before
    page.browser.until("!document.querySelector('#light').disabled")
    page.browser.call("Page.reload")
    page.browser.until("document.querySelector('#caption')?.textContent")
    page.browser.until("!document.querySelector('#light').disabled", 1.5)  # it keeps the control


def test_a_rig_that_is_gone_is_said_until_it_is_back(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "_REOPEN_S", 0.05)
    page.rig.unplug()
    page.shows("#trouble", "cannot be opened")
    page.shows("#rig", "the rig is not open")
    page.rig.connect()
    page.browser.until("document.querySelector('#trouble').hidden")
    page.browser.until("!document.querySelector('#light').disabled")


def test_the_private_file_leads_to_the_page(browser: Browser, rig: LitRig, tmp_path: Path) -> None:
    with served(rig, tmp_path) as made, private_link(made.address) as link:
        browser.visit(link)
        browser.until("document.querySelector('#caption')?.textContent")
        assert browser.value("location.href") == made.address
        assert browser.messages == []
        browser.call("Page.navigate", url="about:blank")


def test_a_program_that_has_ended_is_said(browser: Browser, rig: LitRig, tmp_path: Path) -> None:
    with served(rig, tmp_path) as made:
        page = Page(browser, made, rig)
        page.open()
    page.shows("#trouble", "is the program still running?")
    browser.call("Page.navigate", url="about:blank")


# What is cut off or covers something else: buttons, fields and texts.
FAULTS = """(() => {
  const found = [];
  const kinds = "button, input, select, textarea, canvas, figure, .map, legend, .name";
  const box = (one) => one.getBoundingClientRect();
  const shown = [...document.querySelectorAll(kinds)].filter((one) => box(one).width > 0);
  // What scrolls separately may be above or below the rest.
  const part = (one) => one.closest("header, .picture, fieldset, .results");
  const before = (a, b) => a.right <= b.left + 1 || a.bottom <= b.top + 1;
  const apart = (a, b) => before(a, b) || before(b, a);
  if (document.documentElement.scrollWidth > innerWidth) found.push("the page is too wide");
  for (const one of shown) {
    if (box(one).left < 0 || box(one).right > innerWidth) found.push(`${one.outerHTML} is outside`);
    if (one.matches("button, select") && one.scrollWidth > one.clientWidth + 1)
      found.push(`${one.outerHTML} is cut off`);
    const stage = one.closest(".stage");
    if (stage && box(one).bottom > box(stage).bottom) found.push(`${one.outerHTML} is outside`);
    for (const other of shown) {
      if (one === other || one.contains(other) || part(one) !== part(other)) continue;
      if (!other.contains(one) && !stage && !apart(box(one), box(other)))
        found.push(`${one.outerHTML} covers ${other.outerHTML}`);
    }
  }
  return found;
})()"""


@cases("size", {"desktop": DESKTOP, "small": SMALL, "tablet": TABLET})
def test_nothing_is_cut_off_or_covered(page: Page, size: tuple[int, int]) -> None:
    page.browser.resize(*size, mobile=size == TABLET)
    page.browser.value(FRAME)
    assert page.browser.value(FAULTS) == []
    x, y = page.browser.value(
        "(({x, y}) => [x, y])(document.querySelector('#stop').getBoundingClientRect())"
    )
    page.browser.value("scrollTo(0, document.body.scrollHeight)")
    page.browser.value(FRAME)
    stop = f"document.elementFromPoint({x + 5}, {y + 5})?.id === 'stop'"
    assert page.browser.value(stop)  # it stays in sight
    colour = page.browser.value("getComputedStyle(document.body).backgroundColor")
    assert max(map(int, colour.removeprefix("rgb(").rstrip(")").split(","))) < 60  # dark
    page.browser.value("scrollTo(0, 0)")
    page.press("Bright page")
    page.browser.value(FRAME)
    colour = page.browser.value("getComputedStyle(document.body).backgroundColor")
    assert colour == "rgb(255, 255, 255)"


def test_fingers_zoom_the_picture_and_choose_an_led(page: Page) -> None:
    page.browser.resize(*TABLET, mobile=True)
    page.browser.call("Emulation.setTouchEmulationEnabled", enabled=True)
    try:
        page.browser.value(FRAME)
        page.shows("#caption", "%")
        zoom = "Number(document.querySelector('#caption').textContent.match(/(\\d+) %/)[1])"
        before = page.browser.value(zoom)
        x, y = page.centre("document.querySelector('#view')")
        page.browser.touch(
            [(x - 20, y), (x - 60, y), (x - 100, y)], [(x + 20, y), (x + 60, y), (x + 100, y)]
        )
        page.browser.until(f"{zoom} > {2 * before}")

        def chosen() -> bool:
            page.browser.touch([page.centre(led(4))])
            time.sleep(0.3)
            return "LED 4," in page.text("#caption")

        until(chosen)
    finally:
        page.browser.call("Emulation.setTouchEmulationEnabled", enabled=False)
