"""The parts of ``sgp batch``: what has to run again, names, recipes, tables, one task."""

from __future__ import annotations

import csv
import io
import os
import re
import sys
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest

import acquisition
import rig
from acquisition import DataError, StorageError, import_frames, read_source
from acquisition.session import compact_session
from processing.checks import Cause, Verdict
from sgp.batch import (
    BatchProgress,
    Outcome,
    Recipe,
    Stage,
    States,
    Task,
    csv_table,
    html_table,
    names_of,
    option_words,
    perform,
    read_recipe,
    reason_to_run,
)
from sgp.batch.files import Stamp, difference, stamps
from sgp.cli.exit import UsageError
from sgp.commands.batch import _task
from sgp.results import Result, sha256

SOFTWARE = acquisition.files.software_version()


def copy(source: Path, *, out: Path, force: bool = False, text: str = "", fail: str = "") -> Result:
    """Stand for a command that processes a recording."""
    sys.stderr.write("working\n")
    if fail == "once" and not (out / "tried").exists():
        out.mkdir(exist_ok=True)
        (out / "tried").touch()
        raise StorageError("the disk is full")
    if fail not in ("", "once"):
        raise {
            "disk": StorageError,
            "data": DataError,
            "bug": ZeroDivisionError,
            "memory": MemoryError,
        }[fail](fail)
    files = [path for path in source.iterdir() if path.is_file()]
    out.mkdir(exist_ok=True)
    (out / "copy.txt").write_text(text + "".join(path.read_text() for path in files))
    notice = rig.Notice("files-not-used", "one file")
    figures = {"pixels": 12, "images": 3}
    return Result({"copy": out / "copy.txt"}, {"normals": figures}, [notice], inputs=files)


@pytest.fixture
def source(tmp_path) -> Path:
    folder = tmp_path / "owl"
    folder.mkdir()
    for name in "ab":
        (folder / f"{name}.txt").write_text(name)
    return folder


@pytest.fixture
def task(tmp_path, source) -> Task:
    out = tmp_path / "out"
    stage = Stage("sgp copy", copy, (str(source), f"--out={out / 'owl'}"))
    log = out / "state" / "owl.log"
    return Task("owl", source, (stage,), out / "owl", tmp_path, log, out / "owl.png", attempts=3)


@pytest.fixture
def states(task) -> States:
    return States(task.log.parent)


def with_words(task: Task, *words: str) -> Task:
    stage = task.stages[0]
    return replace(task, stages=(replace(stage, words=(*stage.words, *words)),))


def touch(folder: Path) -> None:
    os.utime(folder / "a.txt", ns=(1, 1))


def edit(folder: Path) -> None:
    (folder / "a.txt").write_text("c")
    touch(folder)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        pytest.param(lambda folder: None, None, id="nothing"),
        pytest.param(touch, None, id="another time"),
        pytest.param(edit, "a.txt was changed", id="as many bytes"),
        pytest.param(lambda f: (f / "b.txt").write_text("longer"), "b.txt was changed", id="size"),
        pytest.param(lambda f: (f / "c.txt").touch(), "c.txt is new", id="one more"),
        pytest.param(lambda f: (f / "a.txt").unlink(), "a.txt was removed", id="one less"),
    ],
)
def test_a_changed_file_is_named(source, change, expected) -> None:
    before = hashed(source)
    change(source)
    assert difference(before, stamps([source])) == expected


def test_results_inside_a_session_are_not_its_files(source) -> None:
    (source / "session.toml").touch()
    (source / "derived").mkdir()
    (source / "derived" / "normals.exr").touch()
    assert {Path(path).name for path in stamps([source])} == {"a.txt", "b.txt", "session.toml"}


def test_a_touched_file_that_was_not_hashed_counts_as_changed(source) -> None:
    before = stamps([source])
    touch(source)
    assert difference(before, stamps([source])) == "a.txt was changed"


def test_a_result_is_computed_again_only_if_it_has_to_be(task, states, monkeypatch) -> None:
    assert reason_to_run(task, {}) == "new"
    outcome = perform(task)
    assert outcome.error is None
    states.write(task, outcome)
    assert reason_to_run(task, states.read_all()) is None
    other = with_words(task, "--text=more")
    assert reason_to_run(other, states.read_all()) == "other options"
    (task.out / "copy.txt").unlink()
    assert reason_to_run(task, states.read_all()) == "copy.txt is missing"
    (task.out / "copy.txt").touch()
    assert reason_to_run(task, states.read_all()) == "copy.txt has 0 bytes instead of 2"
    (task.out / "copy.txt").write_text("ab")
    edit(task.source)
    assert reason_to_run(task, states.read_all()) == "a.txt was changed"
    states.write(task, replace(outcome, error="the disk is full", exit_code=3))
    assert reason_to_run(task, states.read_all()) == "failed before"
    states.write(task, perform(task))
    assert reason_to_run(task, states.read_all()) is None
    monkeypatch.setattr(acquisition.files, "software_version", lambda: "99")
    assert reason_to_run(task, states.read_all()) == f"computed by version {SOFTWARE}"


def test_a_result_that_was_being_overwritten_is_computed_again(task, states) -> None:
    """The files may be those of other options, with which the batch was interrupted."""
    states.write(task, perform(task))
    states.begin(with_words(task, "--text=more"), states.read_all()["owl"])
    assert reason_to_run(task, states.read_all()) == "interrupted before"
    states.write(task, perform(task))
    assert reason_to_run(task, states.read_all()) is None


def test_a_damaged_state_costs_one_source_and_one_of_another_version_is_refused(
    task, states
) -> None:
    states.write(task, perform(task))
    path = states.path("owl")
    whole = path.read_text()
    for text in ("", "[]", "{", whole[: len(whole) // 2], whole.replace('"error": null', '"e": 1')):
        path.write_text(text)
        assert states.read_all() == {}
    path.write_text(whole.replace('"version": 1', '"version": 2'))
    with pytest.raises(DataError, match="has version 2 of sgp-batch-state, and this program"):
        states.read_all()


@pytest.mark.parametrize(
    ("fail", "code", "attempts"),
    [
        pytest.param("", 0, 1, id="success"),
        pytest.param("once", 0, 2, id="an error that passes"),
        pytest.param("disk", 3, 3, id="an error that stays"),
        pytest.param("data", 4, 1, id="wrong data"),
        pytest.param("bug", 1, 1, id="an error in this program"),
        pytest.param("memory", 1, 1, id="too little memory"),
    ],
)
def test_errors_are_outcomes(task, fail, code, attempts, monkeypatch) -> None:
    monkeypatch.setattr("sgp.batch.task_run._PAUSE_S", 0.0)
    outcome = perform(with_words(task, f"--fail={fail}"))
    assert (outcome.exit_code, outcome.attempts) == (code, attempts)
    assert (outcome.error is None) == (code == 0)
    assert "working" in task.log.read_text()


def test_an_outcome_has_files_figures_and_notices(task) -> None:
    outcome = perform(task)
    folder = task.source
    assert {name: stamp.sha256 for name, stamp in outcome.files.items()} == {
        str(folder / name): sha256(folder / name) for name in ("a.txt", "b.txt")
    }
    assert outcome.outputs == (str(task.out / "copy.txt"),)
    assert outcome.notices == {"warning": 1}
    assert outcome.figures == {"pixels": 12, "images": 3}


def test_names_stay_when_sources_are_added(tmp_path) -> None:
    first = names_of([tmp_path / "may" / "owl"], {})
    assert list(first) == ["owl"]
    known = {name: str(path) for name, path in first.items()}
    both = [tmp_path / "june" / "owl", tmp_path / "may" / "owl"]
    assert names_of(both, known) == {"june-owl": both[0], "owl": both[1]}
    assert "state" not in names_of([tmp_path / "state"], {})
    assert list(names_of([tmp_path / "A", tmp_path / "x" / "a"], {})) == ["A", "x-a"]
    with pytest.raises(UsageError, match="is given twice and as"):
        names_of([tmp_path / "owl", tmp_path / "x" / ".." / "owl"], {})


def test_a_recipe_becomes_words(tmp_path) -> None:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        '[calibrate]\nrecordings = "{parent}/balls"\nradius-mm = [12, 8.5]\n'
        '[run]\nmethod = "best"\ndiscontinuity = true\nheight-sigma = false\nk = 2\n'
    )
    found = read_recipe(recipe)
    assert found.folder == tmp_path
    assert option_words(found.run, {}) == ["--method=best", "--discontinuity", "--k=2"]
    places = {"source": "/r/owl", "name": "owl", "parent": "/r"}
    assert option_words({"a": "{parent}/{name}-{x}"}, places) == ["--a=/r/owl-{x}"]
    assert option_words({"radius_mm": [12, 8.5]}, {}) == ["--radius-mm=12", "--radius-mm=8.5"]


def test_a_report_of_a_recipe_follows_the_run() -> None:
    recipe = Recipe(run={"method": "ls"}, report={"full": True})
    task = _task("owl", Path("/r/owl"), recipe, Path("/out"), threads=1, attempts=1)
    assert task.lines() == [
        ["run", "/r/owl", "--out=/out/owl", "--force", "--method=ls"],
        ["report", "/out/owl", "--out=/out/owl/report.html", "--force", "--full"],
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("[run", "recipe.toml: is not TOML", id="not TOML"),
        pytest.param("[walk]\n", "'walk' is unknown: a recipe may have .calibrate.,", id="table"),
        pytest.param("run = 3\n", "'run' is unknown", id="no table"),
        pytest.param('[run]\nout = "x"\n', "out: the batch itself gives this", id="out"),
        pytest.param("[run]\na = {b = 1}\n", "a: give text, a number", id="nested"),
        pytest.param("[calibrate]\nradius-mm = 3\n", "recordings is missing", id="recordings"),
        pytest.param(
            '[calibrate]\nrecordings = "b"\n[run]\nspheres = true\n', "both give", id="both"
        ),
    ],
)
def test_wrong_recipes_are_refused(tmp_path, text, message) -> None:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(text)
    with pytest.raises(DataError, match=message):
        read_recipe(recipe)


def test_tables_escape_what_names_and_errors_contain(task, states, tmp_path) -> None:
    hostile = "<script>\u202e\"'&\n"
    good = states.write(task, perform(task))
    bad = good.model_copy(update={"error": hostile, "source": f"/{hostile}"})
    (tmp_path / "out" / hostile).mkdir()
    (tmp_path / "out" / hostile / "report.html").touch()
    page = html_table(tmp_path / "out", {"owl": good, hostile: bad})
    assert "<script" not in page
    assert "\u202e" not in page
    assert page.index("script") < page.index("owl")  # failed ones first
    assert '<a href="%3Cscript%3E%E2%80%AE%22%27%26%0A/report.html">' in page
    rows = list(csv.DictReader(csv_table({"owl": good, hostile: bad}).splitlines(keepends=True)))
    assert [row["status"] for row in rows] == ["done", "failed"]
    assert rows[0]["pixels"] == "12"
    assert rows[1]["name"] == hostile


def test_tables_have_the_verdict_and_the_worst_result_first(task, states, tmp_path) -> None:
    done = states.write(task, perform(task))
    assert done.verdict == ""
    words = {"a": "good", "b": "", "c": "do-not-use", "d": "check", "e": "<b>"}
    found = {name: done.model_copy(update={"verdict": word}) for name, word in words.items()}
    found["f"] = done.model_copy(update={"error": "no lights"})
    page = html_table(tmp_path / "out", found)
    assert re.findall("<td></td><td>(.)</td>", page) == ["f", "c", "d", "a", "b", "e"]
    assert '<td class="do-not-use">do not use</td>' in page
    rows = csv.DictReader(csv_table(found).splitlines())
    assert {row["name"]: row["verdict"] for row in rows} == {**words, "f": ""}


def test_a_strict_result_that_must_not_be_used_fails_with_its_verdict(task) -> None:
    cause = Cause("x", "lights are wrong", nan, "", nan, 40.0, nan, "")

    def judged(source: Path, *, out: Path, force: bool = False) -> Result:
        result = Result(summary=["36 images"], verdict=Verdict((cause,), 1.0, 0.3, 0.01))
        result.refuse_unusable()
        return result

    outcome = perform(replace(task, stages=(replace(task.stages[0], command=judged),)))
    assert (outcome.exit_code, outcome.verdict) == (6, "do-not-use")
    assert outcome.error == "do not use: lights are wrong (normals change by 40 deg)"


@pytest.mark.parametrize("begin", ["=", "+", "-", "@", "\t", "\n", "\uff1d"])
def test_no_text_of_the_table_is_a_formula(task, states, begin) -> None:
    formula = f"{begin}1+1\r=2"
    state = states.write(task, perform(task))
    state = state.model_copy(update={"error": formula, "source": formula, "seconds": -1.5})
    text = csv_table({formula: state})
    (row,) = csv.DictReader(io.StringIO(text, newline=""))
    assert (row["name"], row["source"], row["error"]) == (f"'{begin}1+1\\r=2",) * 3
    assert row["seconds"] == "-1.5"


def test_a_time_that_was_set_back_and_new_permissions_cost_one_reading(task, states) -> None:
    path = task.source / "a.txt"
    states.write(task, perform(task))
    path.chmod(0o600)
    known = states.read_all()
    assert reason_to_run(task, known) is None
    states.confirm(task.name, known[task.name])
    noted = states.read_all()[task.name].files[str(path)]
    assert noted == Stamp(1, path.stat().st_mtime_ns, sha256(path), path.stat().st_ctime_ns)
    times = path.stat().st_atime_ns, path.stat().st_mtime_ns
    path.write_text("c")
    os.utime(path, ns=times)
    assert reason_to_run(task, states.read_all()) == "a.txt was changed"


def test_a_worker_that_wakes_up_late_replaces_nothing(task) -> None:
    late: list[Outcome] = []

    def sleep(source: Path, *, out: Path, force: bool = False) -> Result:
        if not late:
            late.append(Outcome())
            (source / "a.txt").write_text("newer")
            late.append(perform(awake))
        acquisition.make_folder(out)
        acquisition.write_durably(out / "copy.txt", b"late" if len(late) == 2 else b"new")
        return Result({"copy": out / "copy.txt"}, inputs=[])

    awake = task
    slow = replace(task, stages=(replace(task.stages[0], command=sleep),))
    outcome = perform(slow)
    assert late[1].error is None
    assert outcome.error == "another worker has begun this recording again: this one ends"
    assert outcome.attempts == 1
    assert (task.out / "copy.txt").read_text() in ("newerb", "bnewer")


def test_a_name_that_is_too_long_for_a_file_is_found_before_the_work(task, states) -> None:
    acquisition.make_folder(states.folder)
    assert states.unusable("owl") is None
    assert states.unusable("o" * 252) == "File name too long"


@pytest.mark.parametrize(
    ("others", "said"),
    [
        (0, "1 of 2 sources done, 1 failed</p>"),
        (1, "1 failed; 1 result of another source is in this folder; the table has only the"),
        (7, "1 failed; 7 results of other sources are in this folder; the table has only the"),
    ],
)
def test_the_page_says_what_it_does_not_show(task, states, tmp_path, others, said) -> None:
    good = states.write(task, perform(task))
    bad = good.model_copy(update={"error": "the disk is full", "figures": {}})
    page = html_table(tmp_path / "out", {"owl": good, "cat": bad}, others)
    assert said in page
    # A long error has the width of the figures, which a failed source does not have.
    assert '<td class="text" colspan="5">the disk is full</td>' in page
    widths = [
        row.count("<td") + row.count("<th") + 4 * row.count('colspan="5"')
        for row in page.split("<tr")[1:]
    ]
    assert len(set(widths)) == 1


@pytest.fixture
def session(tmp_path) -> Path:
    """A complete session of one frame that becomes smaller by a compaction."""
    acquisition.write_png(tmp_path / "card.png", np.full((64, 80), 700, np.uint16))
    return import_frames(read_source(tmp_path / "card.png"), tmp_path / "session").folder


def hashed(folder: Path) -> dict[str, Stamp]:
    return {
        path: stamp._replace(sha256=sha256(Path(path))) for path, stamp in stamps([folder]).items()
    }


def test_a_compacted_session_is_the_same(session) -> None:
    before = hashed(session)
    assert compact_session(session).compacted == 1
    assert stamps([session]).keys() != before.keys()
    assert difference(before, stamps([session])) is None
    (frame,) = (session / "frames").iterdir()
    assert difference(hashed(session), stamps([session])) is None
    frame.write_bytes(frame.read_bytes() + b"\0")
    assert "is new" in difference(before, stamps([session]))


def test_a_compacted_session_with_another_change_is_not_the_same(session) -> None:
    before = hashed(session)
    changed = before | {
        path: stamp._replace(sha256="0" * 64)
        for path, stamp in before.items()
        if path.endswith("journal.jsonl")
    }
    compact_session(session)
    assert difference(changed, stamps([session])) is not None
    (session / "COMPLETE").unlink()
    assert difference(before, stamps([session])) is not None


def test_one_slow_task_does_not_spoil_the_time_left(task, monkeypatch) -> None:
    monkeypatch.setattr("sgp.batch.progress.note", lambda line: None)
    progress = BatchProgress(24, 2)
    for seconds in (6000.0, 6.0, 6.0, 6.0):
        progress.started(task)
        progress.ended(task, Outcome(seconds=seconds))
    assert progress.line().startswith("4 of 24 done")
    assert progress.line().endswith("about 60 s left")
