"""Results that know what they were made from: inputs that change, damaged results, batches."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from true_to_input.case import Answer, Outcome, cases, later, sgp
from true_to_input.relief import MASK, directions, images

Change = Callable[[Path], object]
RECONSTRUCT = "processing.reconstruct"
ROOT = Path(__file__).parents[2]


def _recording(folder: Path, name: str = "src", count: int = 8) -> Path:
    """Make a folder of uncompressed TIFFs with a mask; lights.txt is next to it."""
    source = folder / name
    source.mkdir(parents=True)
    for number, image in enumerate(images(directions(count)), 1):
        _write(source / f"{number:03d}.tif", image)
    cv2.imwrite(str(source / "mask.png"), MASK)
    np.savetxt(folder / "lights.txt", directions(count), fmt="%.6f")
    return source


def _write(path: Path, image: Any) -> None:
    values = np.round(image * 65535).astype(np.uint16)
    cv2.imwrite(str(path), values, [cv2.IMWRITE_TIFF_COMPRESSION, 1])


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@contextlib.contextmanager
def _after(module: ModuleType | type, name: str, change: Callable[[], object]) -> Iterator[None]:
    """Call ``change`` once, when a function of a package has returned: its inputs were read."""
    function, pending = getattr(module, name), [change]

    def changed(*args: Any, **kwargs: Any) -> Any:
        result = function(*args, **kwargs)
        if pending:
            pending.pop()()
        return result

    setattr(module, name, changed)
    try:
        yield
    finally:
        setattr(module, name, function)


# Changes of a file.


def _darker(path: Path) -> bytes:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    content = cv2.imencode(path.suffix, (image * 0.3).astype(image.dtype))[1].tobytes()
    if path.suffix == ".tif":
        parameters = [cv2.IMWRITE_TIFF_COMPRESSION, 1]
        dark = (image * 0.3).astype(image.dtype)
        content = cv2.imencode(path.suffix, dark, parameters)[1].tobytes()
    return content


def _replaced(path: Path) -> None:
    """Another image by rename, of the same size in bytes and with the same time."""
    other = path.with_name(".other")
    other.write_bytes(_darker(path))
    shutil.copystat(path, other)
    other.replace(path)


def _rewritten(path: Path) -> None:
    """Another image in place, then the old time of modification."""
    status = path.stat()
    with path.open("r+b") as file:
        file.write(_darker(path))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def _appended(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"\0" * 100)


def _truncated(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def _linked(path: Path) -> None:
    """A link to an older file in place of the file."""
    other = path.parent.parent / f"other{path.suffix}"
    other.write_bytes(_darker(path))
    shutil.copystat(path, other)
    path.unlink()
    path.symlink_to(other)


def _edited(path: Path) -> None:
    """Another value in a text, of the same length."""
    path.write_text(path.read_text().translate(str.maketrans("12", "21")))


def _copied(path: Path) -> None:
    """The same content in a new file, as a program that synchronises folders writes it."""
    other = path.with_name(".other")
    shutil.copyfile(path, other)
    other.replace(path)


def _raced(
    function: str,
    change: Change,
    target: Path,
    words: Sequence[object],
    record: Path,
    *,
    harmless: bool = False,
) -> Outcome:
    """Judge a command during which a file was changed, by the hash of what it had used."""
    module, _, name = function.rpartition(".")
    used = _sha256(target)
    with _after(importlib.import_module(module), name, lambda: change(target)):
        answer = sgp(*words)
    if answer.code:
        named = answer.code == 4 and target.name in answer.message and not harmless
        return Outcome("refused by name" if named else "vague", answer.message)
    recorded = json.loads(record.read_text())
    inputs = recorded.get("inputs") or recorded["provenance"]["inputs"]
    found = next((digest for name, digest in inputs.items() if Path(name) == target), "none")
    if found == used:
        return Outcome("right", "the record has the hash of what was used")
    return Outcome("wrong", "exit 0, and the record has the hash of another file")


@later
def _normals_raced(
    folder: Path, change: Change, target: str, *words: object, harmless: bool = False
) -> Outcome:
    source, out = _recording(folder), folder / "out"
    command = ("normals", source, "--lights", folder / "lights.txt", *words, "--out", out)
    return _raced(
        RECONSTRUCT, change, folder / target, command, out / "normals.json", harmless=harmless
    )


def _camera_raced(folder: Path) -> Outcome:
    import acquisition

    matrix = np.array([[512.0, 0, 59.5], [0, 512.0, 47.5], [0, 0, 1]])
    path = folder / "camera.json"
    acquisition.write_camera(path, acquisition.CameraModel(matrix, 120, 96))
    return _normals_raced(_edited, "camera.json", "--camera", path)(folder)


def _session_raced(folder: Path) -> Outcome:
    session, out = folder / "session", folder / "out"
    made = sgp("simulate", "coin", "--out", session, "--size", "96x78", "--led-count", "8")
    if made.code:
        return Outcome("vague", made.message)
    frame = sorted((session / "frames").iterdir())[3]
    lights = session / "derived" / "truth" / "lights.json"
    words = ("normals", session, "--lights", lights, "--out", out)
    return _raced(RECONSTRUCT, _rewritten, frame, words, out / "normals.json")


def _folder_raced(folder: Path) -> Outcome:
    """The recording is named by a link, which then leads to another recording."""
    source, out = folder / "current", folder / "out"
    source.symlink_to(_recording(folder, "monday"))
    other = folder / "tuesday"
    shutil.copytree(folder / "monday", other)
    for path in other.glob("*.tif"):
        _rewritten(path)

    def change(_: Path) -> None:
        source.unlink()
        source.symlink_to(other)

    words = ("normals", source, "--lights", folder / "lights.txt", "--out", out)
    return _raced(RECONSTRUCT, change, source / "001.tif", words, out / "normals.json")


def _normals_of(folder: Path) -> Path:
    """Make the normals of a recording."""
    source, normals = _recording(folder), folder / "normals"
    sgp("normals", source, "--lights", folder / "lights.txt", "--out", normals)
    return normals


def _detail_raced(folder: Path) -> Outcome:
    normals = _normals_of(folder)

    def change(path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[-2000:-1000] = bytes(1000)
        path.write_bytes(content)

    words = ("detail", "separate", normals, "--out", folder / "out")
    record = folder / "out" / "detail.json"
    return _raced("processing.separate", change, normals / "normals.exr", words, record)


@later
def _of_maps_raced(folder: Path, word: str, change: Change) -> Outcome:
    """A backup program touches the normals while a later command uses them."""
    normals, out = _normals_of(folder), folder / "out"
    function, command, record = {
        "separate": ("processing.separate", ("detail", "separate"), "detail.json"),
        "surface": ("processing.integrate", ("surface",), "surface.json"),
    }[word]
    words = (*command, normals, "--out", out)
    return _raced(function, change, normals / "normals.exr", words, out / record, harmless=True)


def _chmod(path: Path) -> None:
    path.chmod(0o600)


def _of_macos(path: Path) -> None:
    path.write_bytes(b"\0\5\x16\7\0\2")


def _linked_twice(path: Path) -> None:
    """A second name of the same file, as backups by hard links add it."""
    os.link(path, path.with_name("backup"))


def _run_raced(folder: Path) -> Outcome:
    """The file changes after the normals, while detail and surface are computed."""
    source, out = _recording(folder), folder / "out"
    words = ("run", source, "--lights", folder / "lights.txt", "--out", out)
    return _raced("processing.separate", _replaced, source / "006.tif", words, out / "summary.json")


# Batches. Tasks run in this process, so that a file can be changed at a known time.


class _Here:
    def __init__(self, count: int, memory: int | None = None) -> None:
        self.count = 1

    def outcomes(self, tasks: Any, started: Any) -> Iterator[Any]:
        from sgp.batch import perform

        for task in tasks:
            started(task)
            yield task, perform(task)


def _batch(folder: Path, *sources: Path) -> Answer:
    import sgp.commands.batch as module

    recipe = folder / "recipe.toml"
    recipe.write_text('[run]\nlights = "lights.txt"\n')
    kept, module.LocalWorkers = module.LocalWorkers, _Here  # type: ignore[misc, assignment]
    try:
        return sgp("batch", *sources, "--out", folder / "results", "--recipe", recipe)
    finally:
        module.LocalWorkers = kept  # type: ignore[misc]


def _computed_again(answer: Answer, name: str) -> Outcome:
    again = answer.values.get("metrics", {}).get("computed")
    line = next((one for one in answer.err.splitlines() if "again" in one or "date" in one), "")
    if again == 1:
        return Outcome("applied and stated" if name in line else "vague", line)
    return Outcome("wrong", line or answer.message)


def _batch_raced(folder: Path) -> Outcome:
    import processing

    source = _recording(folder)
    with _after(processing.recording.NormalsStage, "run", lambda: _replaced(source / "006.tif")):
        first = _batch(folder, source)
    if first.code:
        second = _batch(folder, source)
        named = "006.tif" in first.err and second.values["metrics"]["done"] == 1
        return Outcome("refused by name" if named else "vague", first.err.splitlines()[0])
    return _computed_again(_batch(folder, source), "006.tif")


@later
def _batch_changed_between(folder: Path, change: Change, target: str) -> Outcome:
    source = _recording(folder)
    _batch(folder, source)
    change(folder / target)
    return _computed_again(_batch(folder, source), Path(target).name)


@later
def _batch_same(folder: Path, change: Change) -> Outcome:
    """Nothing is computed again."""
    source = _recording(folder)
    _batch(folder, source)
    for path in source.iterdir():
        change(path)
    answer = _batch(folder, source)
    again = answer.values["metrics"]["computed"]
    return Outcome("wrong" if again else "right", answer.err.strip().splitlines()[0])


@later
def _long_name(folder: Path, name: str) -> Outcome:
    good = _recording(folder)
    long = folder / name
    shutil.copytree(good, long)
    answer = _batch(folder, long, good)
    metrics = answer.values.get("metrics", {})
    if (metrics.get("done"), metrics.get("failed")) == (2, 0):
        return Outcome("right", "both computed")
    alone = answer.code == 4 and metrics.get("done") == 1 and metrics.get("failed") == 1
    text = next((line for line in answer.err.splitlines() if "FAILED" in line), answer.message)
    tables = (folder / "results" / "batch.csv").exists()
    named = alone and tables and "too long" in text
    return Outcome("refused by name" if named else "wrong", text[-150:])


@later
def _formula(folder: Path, name: str) -> Outcome:
    source = _recording(folder, name)
    answer = _batch(folder, source)
    # A spreadsheet begins a row at each kind of line end.
    with (folder / "results" / "batch.csv").open(newline="") as file:
        row, *more = csv.DictReader(file)
    if more:
        return Outcome("wrong", f"one recording, {1 + len(more)} rows: {more[0]['name']!r}")
    if row["status"] != "done" or float(row["images"]) != 8:
        return Outcome("vague", f"{row} {answer.message}")
    unsafe = [cell for cell in row.values() if cell[:1] in "=+-@\t\r" and not _is_number(cell)]
    return Outcome("wrong" if unsafe else "right", repr(row["name"]))


@later
def _spreadsheet(folder: Path, name: str, separator: str) -> Outcome:
    """A spreadsheet of another country, or with its default settings, begins cells here, too."""
    _batch(folder, _recording(folder, name))
    with (folder / "results" / "batch.csv").open(newline="") as file:
        cells = [cell for row in csv.reader(file, delimiter=separator) for cell in row]
    unsafe = [cell for cell in cells if cell[:1] in "=+-@\t\r" and not _is_number(cell)]
    return Outcome("wrong" if unsafe else "right", repr(unsafe[:1] or cells[-1][:40]))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return not cell
    return True


def _late_worker(folder: Path) -> Outcome:
    """A worker sleeps before it writes; another one does the task on the present images."""
    import processing
    import sgp.commands.batch as module
    from sgp.batch import perform

    source, states = _recording(folder), []
    tasks: list[Any] = []

    class Sleeping(_Here):
        def outcomes(self, given: Any, started: Any) -> Iterator[Any]:
            tasks.extend(given)
            return iter(())

    kept, module.LocalWorkers = module.LocalWorkers, Sleeping  # type: ignore[misc, assignment]
    try:
        words = ("--lights", folder / "lights.txt")
        recipe = folder / "recipe.toml"
        recipe.write_text(f'[run]\nlights = "{words[1]}"\n')
        with contextlib.suppress(KeyError):
            sgp("batch", source, "--out", folder / "results", "--recipe", recipe)
    finally:
        module.LocalWorkers = kept  # type: ignore[misc]
    task = tasks[0]

    def sleep() -> None:
        _rewritten(source / "006.tif")
        states.append(perform(task))
        states.append(_sha256(task.out / "normals" / "normals.exr"))

    with _after(processing.recording.NormalsStage, "run", sleep):
        late = perform(task)
    same = _sha256(task.out / "normals" / "normals.exr") == states[1]
    record = (task.out / "summary.json").exists()
    if states[0].error is None and same and record:
        return Outcome("right", f"the late one ended: {late.error}")
    return Outcome("wrong", "the finished result was rewritten with other images")


@later
def _lost_scheduler(folder: Path, how: str) -> Outcome:
    """A real scheduler, which dies while a worker computes."""
    sources = [_recording(folder / f"part{one}") for one in range(3)]
    file = folder / "scheduler.json"
    shutil.copy(folder / "part0" / "lights.txt", folder / "lights.txt")
    recipe = folder / "recipe.toml"
    recipe.write_text('[run]\nlights = "lights.txt"\n')
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "dask"]
    local = ["--host", "127.0.0.1", "--no-dashboard"]
    running = [
        subprocess.Popen(
            [*dask, "scheduler", "--port", "0", "--scheduler-file", str(file), *local],
            cwd=folder,
            **quiet,
        )
    ]
    try:
        _wait(file.exists)
        address = json.loads(file.read_text())["address"]
        worker = [*dask, "worker", address, "--nthreads", "1", "--no-nanny", *local]
        running.append(subprocess.Popen(worker, cwd=folder, **quiet))
        from distributed import Client

        with Client(address) as client:
            client.wait_for_workers(1, timeout=60)
        words = ["batch", *map(str, sources), "--out", str(folder / "results")]
        words += ["--recipe", str(recipe), "--scheduler", address, "--json"]
        batch = subprocess.Popen(
            [sys.executable, "-m", "sgp", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        _wait(lambda: any((folder / "results" / "state").glob("*.log")))
        time.sleep(0.5)
        if how == "killed":
            running[0].kill()
        else:
            running[0].send_signal(signal.SIGTERM)
        try:
            _, errors = batch.communicate(timeout=150)
        except subprocess.TimeoutExpired:
            batch.kill()
            return Outcome("wrong", "the batch had not ended after 150 s")
    finally:
        for process in running[::-1]:
            process.kill()
            process.wait()
    lines = [line for line in errors.strip().splitlines() if "error" in line.lower()]
    tables = (folder / "results" / "batch.csv").exists()
    clean = "Traceback" not in errors and len(lines) == 1 and "scheduler" in lines[0]
    text = f"exit {batch.returncode}, tables: {tables}: {lines[-1] if lines else ''}"
    good = batch.returncode == 3 and tables and clean
    return Outcome("refused by name" if good else "wrong", text)


def _wait(ready: Callable[[], object]) -> None:
    end = time.monotonic() + 90
    while not ready():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.05)


def _docs_of_workers(folder: Path) -> Outcome:
    import sgp as package

    text = (Path(package.__file__).parents[1] / "docs" / "batch.md").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("dask ")]
    listening = [
        line for line in lines if "--host" not in line or "--dashboard-address" not in line
    ]
    good = not listening and "tls" in text.lower()
    return Outcome("right" if good else "wrong", "; ".join(listening))


# Damaged results.


def _result(folder: Path) -> Path:
    """Make a result of `sgp run`."""
    source, out = _recording(folder), folder / "out"
    sgp("run", source, "--lights", folder / "lights.txt", "--out", out)
    return out


@later
def _verified(
    folder: Path, change: Change, target: str = ".", of: str = "out", *, harmless: bool = False
) -> Outcome:
    path = _result(folder) / target
    change(path)
    answer = sgp("verify", folder / of)
    said = [text for _, text in answer.notices]
    where = [each["where"] for each in answer.values.get("notices", [])]
    if harmless:
        good = answer.code == 0 and not said
        return Outcome("right" if good else "wrong", "; ".join([*said, answer.message]))
    named = answer.code == 4 and any(path.name in one for one in (*said, *where))
    text = "; ".join(f"{one}: {other}" for one, other in zip(where, said, strict=True))
    return Outcome("refused by name" if named else "vague", text or answer.message)


def _verified_without_inputs(folder: Path) -> Outcome:
    out = _result(folder)
    shutil.rmtree(folder / "src")
    answer = sgp("verify", out)
    stated = any("001.tif" in text or "src" in text for _, text in answer.notices)
    text = "; ".join(text for _, text in answer.notices) or answer.message
    return Outcome("applied and stated" if answer.code == 0 and stated else "vague", text)


def _verified_compacted(folder: Path) -> Outcome:
    """The session of a result was made smaller by `capture compact`, which changes no frame."""
    session, out = folder / "session", folder / "out"
    sgp("simulate", "coin", "--out", session, "--size", "96x78", "--led-count", "8")
    sgp("normals", session, "--lights", session / "derived/truth/lights.json", "--out", out)
    sgp("capture", "compact", session)
    answer = sgp("verify", out)
    good = answer.code == 0 and not answer.notices
    return Outcome("right" if good else "wrong", answer.message or str(answer.notices))


def _verified_lights(folder: Path) -> Outcome:
    """The lights of a ring of strengths: their inputs were replaced later."""
    source, out = _recording(folder), folder / "out"
    words = ("--lights", folder / "lights.txt", "--semi-calibrated")
    made = sgp("normals", source, *words, "--out", out)
    if made.code:
        return Outcome("vague", made.message)
    alone = folder / "archive"
    alone.mkdir()
    shutil.copy(out / "lights.json", alone / "lights.json")
    _replaced(source / "003.tif")
    answer = sgp("verify", alone)
    text = "; ".join(
        f"{each['where']}: {each['text']}" for each in answer.values.get("notices", [])
    )
    named = answer.code == 4 and "003.tif" in text
    return Outcome("refused by name" if named else "vague", text or answer.message)


def _changed_record(path: Path) -> None:
    """One digit of a figure."""
    record = json.loads(path.read_text())
    record["metrics"]["separability_deg"] += 1
    path.write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n")


@later
def _linked_archive(folder: Path, change: Change) -> Outcome:
    """An archive that contains a link to the result, and one to itself."""
    out, archive = _result(folder), folder / "archive"
    archive.mkdir()
    (archive / "owl").symlink_to(out)
    (archive / "again").symlink_to(archive)
    change(out / "normals" / "normals.exr")
    answer = sgp("verify", archive)
    text = "; ".join(each["where"] for each in answer.values.get("notices", []))
    named = answer.code == 4 and "normals.exr" in text
    return Outcome("refused by name" if named else "vague", text or answer.message)


@later
def _own_file(folder: Path, name: str, *words: str) -> Outcome:
    """An own file that is cut short, used by a later command."""
    out = _result(folder)
    target = out / name
    os.truncate(target, target.stat().st_size * 2 // 3)
    answer = sgp(*(word.replace("OUT", str(out)) for word in words), "--out", folder / "next")
    if not answer.code:
        return Outcome("wrong", "used without a word")
    command = "record" if target.suffix == ".json" else "`sgp run`"
    wanted = (target.name, command, "again")
    named = answer.code == 4 and all(word in answer.message for word in wanted)
    return Outcome("refused by name" if named else "vague", answer.message)


def _spheres_raced(folder: Path) -> Outcome:
    """An image of spheres is replaced while their lights are computed."""
    session, lights = folder / "session", folder / "lights.json"
    made = sgp("simulate", "spheres", "--out", session, "--size", "480x384", "--led-count", "8")
    if made.code:
        return Outcome("vague", made.message)
    frame = sorted((session / "frames").iterdir())[2]
    words = ("calibrate", "spheres", session, "--out", lights)
    return _raced("calibration.calibrate_spheres", _rewritten, frame, words, lights)


_HASH = "the hash of what was used, or the file named"
_AGAIN = "computed again, and why"
CASES = cases(
    3,
    (
        ("normals_replaced", _HASH, _normals_raced(_replaced, "src/006.tif")),
        ("batch_replaced", "named, and computed again", _batch_raced),
        (
            "batch_truncated_result",
            _AGAIN,
            _batch_changed_between(_truncated, "results/src/normals/normals.exr"),
        ),
        ("verify_changed_output", "the file is named", _verified(_rewritten, "normals/albedo.png")),
        (
            "verify_truncated_output",
            "the file is named",
            _verified(_truncated, "surface/height.exr"),
        ),
        ("verify_clean", "no fault", _verified(Path.exists, harmless=True)),
        (
            "own_normals_cut",
            "the command to run again is named",
            _own_file("normals/normals.exr", "surface", "OUT/normals"),
        ),
        ("batch_long_name", "that recording fails alone", _long_name("n" * 252)),
        ("batch_scheduler_killed", "exit 3, one line, tables", _lost_scheduler("killed")),
        ("batch_formula", "escaped", _formula('=HYPERLINK("x","y")')),
        ("batch_docs_of_workers", "--host and --dashboard-address", _docs_of_workers),
        ("batch_late_worker", "the finished result stays", _late_worker),
    ),
    (
        ("normals_rewritten_same_time", _HASH, _normals_raced(_rewritten, "src/006.tif")),
        ("normals_appended", _HASH, _normals_raced(_appended, "src/002.tif")),
        ("normals_truncated", _HASH, _normals_raced(_truncated, "src/002.tif")),
        ("normals_deleted", _HASH, _normals_raced(Path.unlink, "src/008.tif")),
        ("normals_linked", _HASH, _normals_raced(_linked, "src/001.tif")),
        ("normals_mask_replaced", _HASH, _normals_raced(_replaced, "src/mask.png")),
        ("normals_lights_edited", _HASH, _normals_raced(_edited, "lights.txt")),
        ("normals_camera_edited", _HASH, _camera_raced),
        ("normals_frame_rewritten", _HASH, _session_raced),
        ("normals_folder_link_turned", _HASH, _folder_raced),
        ("detail_normals_rewritten", _HASH, _detail_raced),
        ("run_replaced_after_normals", _HASH, _run_raced),
        ("spheres_frame_rewritten", _HASH, _spheres_raced),
        (
            "normals_only_touched",
            "no refusal",
            _normals_raced(os.utime, "src/006.tif", harmless=True),
        ),
        (
            "normals_only_copied",
            "no refusal",
            _normals_raced(_copied, "src/006.tif", harmless=True),
        ),
        ("normals_only_chmod", "no refusal", _normals_raced(_chmod, "src/006.tif", harmless=True)),
        ("separate_only_linked", "no refusal", _of_maps_raced("separate", _linked_twice)),
        ("surface_only_chmod", "no refusal", _of_maps_raced("surface", _chmod)),
        ("batch_rewritten_same_time", _AGAIN, _batch_changed_between(_rewritten, "src/006.tif")),
        ("batch_replaced_same_time", _AGAIN, _batch_changed_between(_replaced, "src/006.tif")),
        (
            "batch_empty_result",
            _AGAIN,
            _batch_changed_between(lambda p: p.write_bytes(b""), "results/src/surface/surface.ply"),
        ),
        ("batch_only_chmod", "up to date", _batch_same(_chmod)),
        (
            "batch_long_unicode_name",
            "that recording fails alone",
            _long_name("\N{GREEK SMALL LETTER OMEGA}" * 125),
        ),
        ("batch_formula_at", "escaped", _formula("@SUM(1+1)")),
        ("batch_formula_minus", "escaped", _formula("-2+3")),
        ("batch_formula_return", "escaped", _formula("x\r=1+1")),
        ("batch_formula_tab", "escaped", _formula("\t=1+1")),
        ("batch_scheduler_ended", "exit 3, one line, tables", _lost_scheduler("ended")),
        ("verify_missing_output", "the file is named", _verified(Path.unlink, "detail/shape.exr")),
        ("verify_input_replaced", "the image is named", _verified(_replaced, "../src/004.tif")),
        ("verify_record_cut", "the record is named", _verified(_truncated, "normals/normals.json")),
        (
            "verify_folder_of_results",
            "the file is named",
            _verified(_appended, "normals/normals.exr", "."),
        ),
        (
            "verify_record_edited",
            "the record is named",
            _verified(_changed_record, "detail/detail.json", "out/detail"),
        ),
        (
            "verify_record_of_stage_gone",
            "the record is named",
            _verified(Path.unlink, "surface/surface.json"),
        ),
        ("verify_links_in_archive", "the file is named", _linked_archive(_truncated)),
        (
            "verify_files_of_macos",
            "no fault",
            _verified(_of_macos, "._summary.json", harmless=True),
        ),
        ("batch_csv_semicolon", "no formula", _spreadsheet("x;=1+1", ";")),
        ("batch_csv_tab", "no formula", _spreadsheet("x\t=1+1", "\t")),
        ("verify_compacted", "no fault", _verified_compacted),
        ("verify_inputs_gone", "stated, exit 0", _verified_without_inputs),
        ("verify_lights", "the image is named", _verified_lights),
        (
            "own_record_cut",
            "the command to run again is named",
            _own_file("normals/normals.json", "export", "OUT"),
        ),
        (
            "own_mask_cut",
            "the command to run again is named",
            _own_file("normals/mask.png", "surface", "OUT/normals"),
        ),
        (
            "own_sigma_cut",
            "the command to run again is named",
            _own_file(
                "normals/normal_sigma_deg.exr",
                "surface",
                "OUT/normals",
                "--sigma",
                "OUT/normals/normal_sigma_deg.exr",
            ),
        ),
    ),
)
