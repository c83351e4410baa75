"""Take the pictures of `capture preview` in docs/ with a headless Chromium.

python benchmarks/screen_pictures.py --out docs
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import cv2

sys.path.insert(0, str(Path(__file__).parents[1]))

from acquisition import CapturePlan
from sgp.screen import Light
from tests.sgp.chromium import Browser
from tests.sgp.screen_rig import LitRig, served

WINDOWS: Final = {"desktop": (1280, 800), "small": (1024, 600), "tablet": (820, 1180)}
LIGHT: Final = Light("one", (7,), 22_000.0)
PLAN: Final = CapturePlan(leds="0-35", exposures_us=(22_000.0,))
# Shades of the picture that become one, which halves the file.
SHADES: Final = 4


def main() -> None:
    """Take the pictures, with the console messages of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    rig = LitRig((640, 512), leds=36)
    with tempfile.TemporaryDirectory() as scratch:
        browser = Browser(Path(scratch) / "profile", "--enable-unsafe-swiftshader")
        try:
            with served(rig, Path("recordings"), plan=PLAN, light=LIGHT, pixel_mm=0.05) as made:
                for name, size in WINDOWS.items():
                    browser.resize(*size, mobile=name == "tablet")
                    browser.visit(made.address)
                    browser.until("document.querySelector('#caption').textContent !== ''")
                    time.sleep(2)  # of focus
                    file = given.out / f"screen-{name}.png"
                    browser.screenshot(file)
                    few = cv2.imread(str(file)) // SHADES * SHADES
                    cv2.imwrite(str(file), few, (cv2.IMWRITE_PNG_COMPRESSION, 9))
                    print(f"{file}: {file.stat().st_size} bytes, console: {browser.messages}")
        finally:
            browser.close()
            rig.close()


if __name__ == "__main__":
    main()
