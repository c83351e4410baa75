"""A program that watches a folder and ends in the middle of an image."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from acquisition import Session
from tests.acquisition.test_watch_faults import lights, shoot, until
from tests.forked import ForkServer

PROGRAM = """
import sys
from pathlib import Path
from acquisition import watch_folder
from acquisition.imports import Watch, lights_in_order
folder, out, leds = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
watch = Watch(folder, lights_in_order(leds), timeout_s=30.0, settle_s=0.05)
watch_folder(watch, out, on_message=lambda line: print(line, flush=True))
"""


@pytest.mark.parametrize(
    "ending",
    [
        pytest.param(signal.SIGKILL, id="kill-9"),
        pytest.param(signal.SIGINT, id="ctrl-c", marks=pytest.mark.slow),
    ],
)
def test_a_process_that_ends_and_a_pause_lose_nothing(
    folder: Path, out: Path, forks: ForkServer, ending: signal.Signals
) -> None:
    """Two images, the end of the process while the third is written, a pause, and the rest."""
    process = forks.start(PROGRAM, folder, out, 6)
    for number in range(2):
        shoot(folder, number)
        # Every image is recorded as it arrives: none waits for the next.
        until(lambda n=number: len(list(out.glob("frames/L*.tif"))) == n + 1)
    data = shoot(folder.parent, 2).read_bytes()
    (folder / "IMG_0002.png").write_bytes(data[:100])
    process.send_signal(ending)
    assert process.wait(60) != 0
    process.end()
    for path in folder.iterdir():  # a pause of an hour
        os.utime(path, (time.time() - 3600, time.time() - 3600))
    (folder / "IMG_0002.png").write_bytes(data)
    process = forks.start(PROGRAM, folder, out, 6)
    for number in (4, 3, 5):
        shoot(folder, number)
        time.sleep(0.1)
    assert process.wait(60) == 0
    process.end()
    assert lights(out) == {number: number for number in range(6)}
    assert Session.open(out).complete
