"""Unplug board and camera of `capture preview` at random, again and again, as an operator works.

python benchmarks/screen_unplugged.py --losses 200

The station and its server run in this process, on a virtual board at a pty and a GenTL camera. The
operator clicks LEDs, fetches frames, meters, checks, records and resumes over HTTP. Meanwhile,
board or camera disappear at random moments, and are back after a random time.

Exit code 1 if a live or recorded frame shows another LED than stated, a recording does not become
complete or does not verify, an LED stays on, or the page stops answering.
"""

import json
import random
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from capture_bench import (
    EXPOSURE_US,
    LEDS,
    NOISE,
    PLAN,
    SIZE,
    dark_in_time,
    is_complete,
    open_state,
    plane,
    wrong_frames,
)
from harness import command_line

from acquisition import Session
from sgp.screen import Light
from sgp.screen.plan_sheet import text_of
from simulator.camera import GentlCamera, ImageFormation
from simulator.led_board import BoardFault, VirtualBoard
from tests.sgp.screen_rig import RigFile, served

LIMIT_S = 60.0
LONGEST_AWAY_S = 1.5
REGION = f"left=0&top=0&width={SIZE[1]}&height={SIZE[0]}&columns={SIZE[1]}&rows={SIZE[0]}"
# What the screen shows of each LED without noise, up to a factor.
SHADES = np.array([plane(led).ravel() ** (1 / 2.2) for led in range(LEDS)])
SHADES -= SHADES.mean(axis=1, keepdims=True)


class Bench:
    """Virtual devices that disappear and return, and their rig file."""

    def __init__(self, stack, folder, draw, isolate):
        self._draw = draw
        self.board = stack.enter_context(VirtualBoard(LEDS))
        self.state = open_state(self.board.bench_state_path)
        stack.callback(self.state.close)
        self.camera = stack.enter_context(
            GentlCamera(
                plane,
                size=SIZE,
                leds=LEDS,
                bench_state_path=self.board.bench_state_path,
                formation=ImageFormation(NOISE, noisy=False),
            )
        )
        self.file = folder / "rig.toml"
        self.file.write_text(
            f'name = "planes"\ndriver = "bench"\nleds = {LEDS}\nsettle_ms = 0.5\n'
            f'[options]\nport = "{self.board.port}"\ncti = "{self.camera.cti}"\n'
            f"isolate = {str(isolate).lower()}\n"
        )

    def lose(self):
        """Unplug board or camera, and plug it in again; return which."""
        away_s = self._draw.uniform(0.05, LONGEST_AWAY_S)
        if self._draw.random() < 0.5:
            # Before one of the next commands, whatever it is.
            skip, away_ms = self._draw.randrange(8), round(away_s * 1000)
            self.board.set_faults(BoardFault(kind="hang-up", skip=skip, value=away_ms))
            time.sleep(away_s)
            return "board"
        self.camera.unplug()
        time.sleep(away_s)
        self.camera.replug()
        return "camera"


class Operator:
    """Works with the page until the end; what is wrong is listed."""

    def __init__(self, page, draw):
        self._page, self._draw = page, draw
        self.counts, self.wrong, self.recordings = Counter(), [], []
        self.over = False

    def watch(self):
        """Be an open page."""
        with self._page.watched() as states:
            while not self.over:
                next(states)

    def work(self):
        """Do one thing after the other."""
        while not self.over:
            self._draw.choice((self.click, self.click, self.prepare, self.record))()

    def click(self):
        """Choose LEDs, and look at some frames."""
        leds = self._draw.sample(range(LEDS), self._draw.choice((1, 4)))
        mode = "one" if len(leds) == 1 else "cycle"
        code, _ = self._page.do(do="light", mode=mode, leds=leds, exposure_us=EXPOSURE_US)
        self.counts["clicks", code] += 1
        for _ in range(self._draw.randrange(1, 12)):
            self.look()

    def look(self):
        """Check the LED of a live frame by its picture."""
        last = self._page.station.frame
        link = f"frame?after={last.number if last else 0}&{REGION}&clipped=0&peaking=0"
        with urllib.request.urlopen(self._page.address + link, timeout=LIMIT_S) as answer:
            self.counts["frames", answer.status] += 1
            picture, stated = answer.read(), answer.headers["x-frame"]
        if not picture:  # the picture stands still meanwhile
            return
        (stated,) = json.loads(stated)["leds"]
        grey = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE)
        shown = int(np.argmax(SHADES @ (grey.ravel() - grey.mean())))
        if shown != stated:
            self.wrong.append(f"live frame of LED {stated} shows LED {shown}")

    def prepare(self):
        """Meter the plan, or check rig and picture for it."""
        action = self._draw.choice(({"do": "meter", "each": True}, {"do": "check"}))
        if self._page.do(**action)[0] == 200:
            self.counts[action["do"], self.wait()["failure"].partition(",")[0]] += 1

    def record(self):
        """Record the plan, and take what is missing."""
        self._page.do(do="plan", text=text_of(PLAN))
        name = f"object {len(self.recordings)}"
        if self._page.do(do="record", object=name, check=False)[0] != 200:
            return
        self.recordings.append(name)
        ends_s = time.monotonic() + LIMIT_S
        while (state := self.wait())["recording"]["state"] != "complete":
            if state["recording"]["state"] == "not begun" or time.monotonic() > ends_s:
                self.wrong.append(f"{name}: {state['recording']['state']}, {state['failure']}")
                return
            code, _ = self._page.do(do="resume")
            self.counts["resume", code, state["failure"].partition(",")[0]] += 1

    def wait(self):
        """Return the state after the end of the task."""
        while (state := self._page.station.state())["task"] is not None:
            if state["question"]:
                self.wrong.append(f"a question: {state['question']['text']}")
                self._page.do(do="answer", question=state["question"]["id"], yes=False)
            time.sleep(0.05)
        return state


def main():
    parser = command_line(__doc__)
    parser.add_argument("--losses", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--isolate", action="store_true", help="the GenTL producer in a separate process"
    )
    options = parser.parse_args()
    draw = random.Random(options.seed)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sgp-unplugged-")))
        bench = Bench(stack, folder, draw, options.isolate)
        out = folder / "recordings"
        light = Light("one", (0,), EXPOSURE_US)
        page = stack.enter_context(served(RigFile(bench.file), out, plan=PLAN, light=light))
        wrong = strike(bench, page, options)
        page.station.stop("the benchmark")
        if not dark_in_time(bench.state):
            wrong.append("an LED stays on")
    for line in wrong:
        print(f"WRONG: {line}")
    print("FAILED" if wrong else "passed")
    sys.exit(bool(wrong))


def strike(bench, page, options):
    """Lose devices while the operator works; return what was wrong."""
    operator = Operator(page, random.Random(options.seed + 1))
    threads = [threading.Thread(target=one, daemon=True) for one in (operator.watch, operator.work)]
    for thread in threads:
        thread.start()
    began_s = time.monotonic()
    draw = random.Random(options.seed + 2)
    lost = Counter()
    for number in range(options.losses):
        time.sleep(draw.uniform(0, 1))
        before = page.station.state()
        lost[bench.lose(), before["task"] or "live picture"] += 1
        ends_s = time.monotonic() + LIMIT_S
        while alive(page.station.state()) == alive(before):
            if time.monotonic() > ends_s:
                state = page.station.state()
                operator.wrong.append(f"after loss {number}: {state['trouble']}, {state['task']}")
                break
            time.sleep(0.05)
        if number % 10 == 9:
            print(f"{number + 1} losses, {time.monotonic() - began_s:.0f} s", flush=True)
    operator.over = True
    for thread in threads:
        thread.join(3 * LIMIT_S)
        if thread.is_alive():
            operator.wrong.append("the operator waits forever")
    wrong = [*operator.wrong, *map(str, page.errors)]
    for name in operator.recordings:
        folder = page.out / name
        wrong += wrong_frames(folder) + ([] if is_complete(folder) else [f"{name}: incomplete"])
    events = Counter(
        (line.event, line.details.get("device", ""))
        for name in operator.recordings
        for line in Session.open(page.out / name).events
    )
    for counts in (lost, operator.counts, events):
        for names, count in sorted(counts.items(), key=str):
            print(f"{count:6}  {', '.join(map(str, names))}")
    print(f"{len(operator.recordings)} recordings, {time.monotonic() - began_s:.0f} s")
    return wrong


def alive(state):
    """Return what changes when a frame was taken."""
    recording = state["recording"] or {"folder": "", "frames": ()}
    live = state["live"]["frame"].get("number", 0)
    return live, recording["folder"], len(recording["frames"])


if __name__ == "__main__":
    main()
