"""Take the pictures of reports in docs/ with a headless Chromium, at 1280x800 and 390x844.

sgp demo --out demo
sgp detail fill NORMALS --holes HOLES --out fill
python benchmarks/report_pictures.py demo fill --out docs
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Final
from urllib.parse import quote

sys.path.insert(0, str(Path(__file__).parents[1]))

from rig import MAX_PIXELS
from sgp.report import make_report
from tests.sgp.chromium import Browser

DESKTOP: Final = (1280, 800)
PHONE: Final = (390, 844)
MARKS: Final = [
    {"points": [[-70, 22], [70, 10]], "text": "rim to rim"},
    {"points": [[-38, -48], [-8, -48], [-8, -18], [-38, -18]], "text": "waves"},
]
SURFACE: Final = f"#view=surface3d&light=135.0,25.0&marks-0={quote(json.dumps(MARKS))}"
SIDE: Final = "#layout=side&light=135.0,30.0"
RAISED: Final = """(() => {
  const one = [...document.querySelectorAll('#view-surface3d .slider')]
    .find((row) => row.textContent.startsWith('Heights')).querySelector('input');
  one.value = 3; one.dispatchEvent(new Event('input'));
})()"""
# File, which page, its address, window, dark colours, and where the window begins.
PICTURES: Final = (
    ("report-desktop", "fill", SIDE, DESKTOP, False, None),
    ("report-phone", "fill", SIDE, PHONE, False, None),
    ("report-demo", "demo", SIDE, DESKTOP, False, None),
    ("report-dark", "demo", "#light=135.0,30.0", DESKTOP, True, None),
    ("report-lights", "demo", "", DESKTOP, False, ".columns"),
    ("measuring", "demo", SURFACE, DESKTOP, False, None),
    ("measuring-phone", "demo", SURFACE, PHONE, False, None),
    ("measuring-profile", "demo", SURFACE, PHONE, False, "section.mark"),
)
DRAWN: Final = (
    "[...document.querySelectorAll('canvas')].some((one) => Number(one.dataset.drawn) > 1)"
)
SETTLED: Final = "new Promise((done) => setTimeout(done, 1500))"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demo", type=Path, help="folder of `sgp demo`")
    parser.add_argument("fill", type=Path, help="folder of `sgp detail fill`")
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder of the pictures")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        pages = {}
        for name, folder in (("demo", given.demo), ("fill", given.fill)):
            pages[name] = Path(scratch) / f"{name}.html"
            made = make_report([folder], max_pixels=MAX_PIXELS)
            pages[name].write_text(made.html, encoding="utf-8")
        browser = Browser(Path(scratch) / "profile", "--enable-unsafe-swiftshader")
        try:
            for name, page, address, window, dark, top in PICTURES:
                browser.resize(*window, mobile=window == PHONE, dark=dark)
                browser.open(pages[page], address)
                browser.until(DRAWN)
                if address == SURFACE:
                    browser.until("document.querySelector('canvas.surface')?.dataset.texture")
                    browser.value(RAISED)
                if top is not None:
                    browser.value(
                        f"(document.querySelector({top!r}).closest('section') ?? document.body)"
                        ".scrollIntoView()"
                    )
                browser.value(SETTLED)
                browser.screenshot(given.out / f"{name}.png")
                wide = browser.value("document.documentElement.scrollWidth")
                print(f"{name}: {wide} px wide, console: {browser.messages or 'nothing'}")
        finally:
            browser.close()


if __name__ == "__main__":
    main()
