"""``sgp batch``: many recordings, run again, failures, and real workers."""

from __future__ import annotations

import csv
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition import read_image, write_png
from sgp.batch import perform
from tests.quick_sample import quick
from tests.sgp.conftest import ball, ring_lights

SGP = [sys.executable, "-m", "sgp"]


class Here:
    """Perform tasks in this process, so that tests need not start others."""

    def __init__(self, count: int, memory: int | None = None) -> None:
        """Accept what `LocalWorkers` accepts."""
        self.count = 1

    def outcomes(self, tasks, started):
        for task in tasks:
            started(task)
            yield task, perform(task)


@pytest.fixture
def here(monkeypatch) -> None:
    monkeypatch.setattr("sgp.commands.batch.LocalWorkers", Here)


@pytest.fixture
def two(recording, tmp_path) -> list[Path]:
    """Two recordings, of which the second is brighter."""
    other = tmp_path / "bright"
    other.mkdir()
    normals, _ = ball()
    for i, light in enumerate(ring_lights().unit_directions):
        shade = 0.9 * np.clip(normals @ light, 0, 1)
        write_png(other / f"ball.{i}.png", np.rint(shade * 65535).astype(np.uint16))
    return [recording, other]


@pytest.fixture
def recipe(tmp_path) -> Path:
    path = tmp_path / "recipe.toml"
    path.write_text('[run]\nlights = "lights.json"\n')
    return path


def table(out: Path) -> dict[str, dict[str, str]]:
    with (out / "batch.csv").open(newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def damage(folder: Path) -> None:
    (folder / "ball.3.png").write_bytes(b"no image")


def test_a_batch_does_what_is_missing(here, sgp, two, recipe, tmp_path) -> None:
    out = tmp_path / "out"
    words = ["batch", *two, "--out", out, "--recipe", recipe, "--json"]
    kept = (two[1] / "ball.3.png").read_bytes()
    damage(two[1])
    answer = sgp(*words)
    assert answer.code == 4
    assert json.loads(answer.out)["metrics"] == {
        "sources": 2, "done": 1, "failed": 1, "computed": 2,
    }  # fmt: skip
    assert {name: row["status"] for name, row in table(out).items()} == {
        "ball": "done",
        "bright": "failed",
    }
    assert "ball.3.png" in table(out)["bright"]["error"]
    picture = read_image(out / "thumbnails" / "ball.png")
    assert picture.shape == (160, 192, 3)
    assert np.ptp(picture[75:85, 94:98].astype(int), axis=(0, 1)).max() < 40  # flat in the middle
    (two[1] / "ball.3.png").write_bytes(kept)
    answer = sgp(*words).ok()
    assert json.loads(answer.out)["metrics"]["computed"] == 1
    assert "bright: computed again: failed before" in answer.err
    assert json.loads(sgp(*words).out)["metrics"]["computed"] == 0
    os.utime(two[0] / "ball.0.png")
    assert json.loads(sgp(*words).out)["metrics"]["computed"] == 0
    damage(two[0])
    assert "ball: computed again: ball.3.png was changed" in sgp(*words).err
    by_hand = tmp_path / "by-hand"
    lights = ["--lights", tmp_path / "lights.json"]
    assert sgp("run", two[1], *lights, "--out", by_hand).code == 0
    for name in ("normals/normals.exr", "surface/height.exr"):
        assert (out / "bright" / name).read_bytes() == (by_hand / name).read_bytes()


@pytest.mark.parametrize(
    ("content", "missing"),
    quick(
        [
            ('[run]\nlights = "light.json"\n', "light.json"),
            ('[run]\nlights = "{sorce}/lights.json"\n', "{sorce}/lights.json"),
            ('[calibrate]\nrecordings = ["balls"]\n', "balls"),
            ('[calibrate]\nrecordings = ["{parent}/balls", "balls"]\n', "balls"),
        ],
        every=4,
    ),
    ids=["file", "word in braces", "recording", "second recording"],
)
def test_files_of_a_recipe_that_do_not_exist_cost_no_result(
    here, sgp, recording, recipe, tmp_path, content, missing
) -> None:
    """Without this check, every source fails, and all are computed again later."""
    words = ["batch", recording, "--out", tmp_path / "out", "--recipe", recipe]
    assert sgp(*words).code == 0
    whole = recipe.read_text()
    recipe.write_text(content)
    text = sgp(*words).error_line(2)
    assert f"recipe.toml: {missing}: no such file" in text
    assert text.endswith(f"its paths are relative to {tmp_path}")
    recipe.write_text(whole)
    assert "1 result is up to date" in sgp(*words).err


@pytest.mark.slow
def test_a_file_that_one_source_lacks_is_its_own_failure(here, sgp, two, recipe, tmp_path) -> None:
    (two[0] / "own.json").write_bytes((tmp_path / "lights.json").read_bytes())
    (two[0] / "curve.txt").write_text("0 0\n65535 1\n")
    recipe.write_text('[run]\nlights = "{source}/own.json"\ngamma = "{source}/curve.txt"\n')
    assert sgp("batch", *two, "--out", tmp_path / "out", "--recipe", recipe, "--json").code == 4
    assert {name: row["status"] for name, row in table(tmp_path / "out").items()} == {
        "ball": "done",
        "bright": "failed",
    }


class Interrupted(Here):
    """Does the work of a task, but is interrupted before the outcome arrives."""

    def outcomes(self, tasks, started):
        for _ in super().outcomes(tasks, started):
            raise KeyboardInterrupt
        yield from ()


@pytest.mark.slow
def test_an_interrupted_batch_with_other_options_leaves_no_result_that_counts(
    here, sgp, recording, recipe, tmp_path, monkeypatch
) -> None:
    out, other = tmp_path / "out", tmp_path / "other.toml"
    other.write_text('[run]\nlights = "lights.json"\nmethod = "ls"\n')
    words = ["batch", recording, "--out", out, "--recipe"]
    assert sgp(*words, recipe).code == 0
    kept = (out / "ball" / "normals" / "normals.exr").read_bytes()
    monkeypatch.setattr("sgp.commands.batch.LocalWorkers", Interrupted)
    assert sgp(*words, other).code == 130
    assert (out / "ball" / "normals" / "normals.exr").read_bytes() != kept
    monkeypatch.setattr("sgp.commands.batch.LocalWorkers", Here)
    assert "ball: computed again: interrupted before" in sgp(*words, recipe).err
    assert (out / "ball" / "normals" / "normals.exr").read_bytes() == kept


def test_wrong_commands_are_refused_before_any_work(here, sgp, two, recipe, tmp_path) -> None:
    out = tmp_path / "out"
    asked = ["batch", *two, "--out", out]
    assert "is given twice" in sgp("batch", two[0], two[0], "--out", out).error_line(2)
    recipe.write_text("[run]\nmethod = 'bst'\n")
    assert "bst" in sgp(*asked, "--recipe", recipe).error_line(2)
    recipe.write_text("[run]\ncolour = true\n")
    assert "--colour" in sgp(*asked, "--recipe", recipe).error_line(2)
    recipe.write_text("[report]\nful = true\n")
    assert "--ful" in sgp(*asked, "--recipe", recipe).error_line(2)
    text = sgp(*asked, "--workers", "2", "--scheduler", "tcp://127.0.0.1:1").error_line(2)
    assert text.endswith("give one")
    text = sgp(*asked, "--memory", "2G", "--scheduler", "tcp://127.0.0.1:1").error_line(2)
    assert text.endswith("--memory-limit")
    text = sgp(*asked, "--memory", "1M").error_line(2)
    assert "--memory 1M is too small" in text
    assert text.endswith("give at least --memory 512M")
    assert not out.exists() or not any(path.is_file() for path in out.rglob("*"))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").touch()
    assert "already contains files" in sgp("batch", *two, "--out", tmp_path / "full").error_line(2)
    assert "folder of the input" in sgp("batch", *two, "--out", two[0] / "out").error_line(2)


def test_two_batches_do_not_share_a_folder(here, sgp, two, tmp_path) -> None:
    state = tmp_path / "out" / "state"
    state.mkdir(parents=True)
    place = os.open(state, os.O_RDONLY)
    try:
        fcntl.flock(place, fcntl.LOCK_EX)
        text = sgp("batch", *two, "--out", tmp_path / "out").error_line(2)
    finally:
        os.close(place)
    assert "another batch is writing into" in text


def started(*words: object) -> subprocess.Popen[str]:
    command = [*SGP, *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def children(pid: int) -> list[int]:
    """Return the workers of a batch, without the process that tracks its semaphores."""
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [
        int(child)
        for child in found
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]


def wait_for(what, limit_s: float = 100.0):
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        if found := what():
            return found
        time.sleep(0.05)
    raise TimeoutError


@pytest.mark.slow
def test_a_process_gets_no_more_memory_than_allowed(two, recipe, tmp_path) -> None:
    words = ("--recipe", recipe, "--workers", 1, "--memory", "1G")
    run = started("batch", two[0], "--out", tmp_path / "out", *words)
    printed, errors = run.communicate(timeout=280)
    assert run.returncode == 0, errors
    assert "1 of 1 source done" in printed
    code = "import numpy as np; from sgp.batch.local import limit_memory; limit_memory(2**30)"
    code += "; np.ones(2**22); np.ones(2**28)"
    one = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Unable to allocate 2.00 GiB" in one.stderr


@pytest.mark.slow
def test_real_workers_and_one_that_is_killed(two, recipe, tmp_path) -> None:
    out = tmp_path / "out"
    recipe.write_text(f"{recipe.read_text()}[report]\nfull = true\n")
    run = started("batch", *two, "--out", out, "--recipe", recipe, "--workers", "1")
    (first,) = wait_for(lambda: children(run.pid))
    wait_for((out / "state" / "ball.log").exists)
    os.kill(first, signal.SIGKILL)
    printed, errors = run.communicate(timeout=280)
    assert run.returncode == 0, errors
    assert "2 of 2 sources done" in printed
    assert {row["status"] for row in table(out).values()} == {"done"}
    assert {row["pixels"] != "" for row in table(out).values()} == {True}
    assert "ball/report.html" in (out / "index.html").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_batch_that_is_ended_leaves_no_process_and_continues(
    two, recipe, tmp_path, number
) -> None:
    out = tmp_path / "out"
    words = ("batch", *two, "--out", out, "--recipe", recipe, "--workers", "2")
    run = started(*words)
    workers = wait_for(lambda: len(found := children(run.pid)) == 2 and found)
    wait_for(lambda: (out / "state" / "ball.log").exists())
    run.send_signal(number)
    _, errors = run.communicate(timeout=100)
    ended = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -9}
    assert run.returncode == ended[number], errors
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
    again = started(*words)
    printed, errors = again.communicate(timeout=280)
    assert again.returncode == 0, errors
    assert "2 of 2 sources done" in printed
