"""What a result is of, and whether it was recorded as stated: names, clocks, echoes, networks."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from true_to_input.case import Answer, Outcome, cases, later, sgp
from true_to_input.relief import MASK, H, W, directions, images, write_lp

_COUNT = 6
_LABELS = {
    "object": "Owl of Athena, inv. 1882",
    "operator": "Grace Hopper",
    "place": "Storage 4",
    "notes": "after cleaning",
    "rights": "CC BY 4.0, City Museum",
}
_STARTED = datetime(2026, 3, 14, 9, 26, tzinfo=UTC)
_RIG = {
    "name": "dome",
    "driver": "bench",
    "board": "sgp-led-board",
    "protocol": "2",
    "firmware": "1",
    "leds": _COUNT,
}
_CAMERA = {"width": W, "height": H, "bit_depth": 16, "vendor": "Maker", "model": "Eye"}
_VIRTUAL = {"vendor": "sgp", "model": "virtual camera"}
_LIGHTS = directions(_COUNT)
# Seeds of networks, the first of which ended the process; the others were refused or used.
_STRUCK = (17, 26, 114, 116, 131, 0, 1, 2, 7, 8)


def _session(
    folder: Path,
    *,
    labels: Mapping[str, str] = _LABELS,
    rig: Mapping[str, object] | None = _RIG,
    camera: Mapping[str, object] = _CAMERA,
    clock: Callable[[int], timedelta] = lambda line: timedelta(seconds=2 * line),
) -> Path:
    """Record the relief as a rig would; ``clock`` is the time of each line of the journal."""
    import acquisition
    from acquisition import Calibrations, CapturePlan
    from acquisition.session import Echo, Manifest, RigRecord, SessionWriter

    texts = dict(labels)
    plan = CapturePlan(leds=tuple(range(_COUNT)), exposures_us=(1000.0,))
    stored = None if rig is None else RigRecord.model_validate(dict(rig))
    manifest = Manifest.begin(
        folder,
        camera=dict(camera),
        labels=acquisition.Labels(object_name=texts.pop("object"), **texts),
        calibrations=Calibrations(lights=acquisition.Lights(directions=_LIGHTS)),
        plan=None if rig is None else plan,
        rig=stored,
    ).model_copy(update={"started_utc": _STARTED})
    lines = iter(range(1000))
    writer = SessionWriter.create(folder, manifest, clock=lambda: _STARTED + clock(next(lines)))
    with writer:
        pictures = images(_LIGHTS)
        for number, shot in enumerate(plan.shots()):
            image = pictures[shot.led] if shot.led is not None else np.zeros((H, W))
            echo = None if rig is None else Echo(seq=number, led=shot.led, lit_us=900, active_us=0)
            writer.write_frame(shot, np.round(image * 65535).astype(np.uint16), echo=echo)
        writer.complete()
    (folder / "derived").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "derived" / "mask.png"), MASK)
    return folder


def _simulated(folder: Path, **others: Any) -> Path:
    return _session(folder, rig={**_RIG, "driver": "simulated"}, **others)


def _done(*words: object) -> Answer:
    answer = sgp(*words)
    if answer.code:
        raise RuntimeError(answer.message)
    return answer


def _normals(source: Path, *options: object) -> Path:
    out = source.with_name(f"{source.name}-normals")
    _done("normals", source, *options, "--out", out)
    return out


def _record(path: Path) -> list[dict[str, Any]]:
    found = json.loads(path.read_text(encoding="utf-8")).get("recordings", [])
    return list(found)


def _states(found: list[dict[str, Any]], *, simulated: bool = True) -> Outcome:
    """Judge what a record says of the recordings that its result was computed from."""
    if len(found) != 1:
        return Outcome("wrong", f"the record names {len(found)} recordings")
    one = found[0]
    wrong = [key for key, text in _LABELS.items() if one.get(key) != text]
    if one.get("started_utc", "")[:16] != "2026-03-14T09:26":
        wrong.append("date")
    if one.get("simulated", False) is not simulated:
        wrong.append("simulated")
    return Outcome("wrong" if wrong else "right", f"wrong: {wrong}" if wrong else one["object"])


def _contains(text: str, wanted: Iterable[str]) -> Outcome:
    missing = [one for one in wanted if one not in text]
    return Outcome("wrong" if missing else "right", f"missing: {missing}" if missing else "all")


def _normals_record(folder: Path) -> Outcome:
    return _states(_record(_normals(_simulated(folder / "s")) / "normals.json"))


def _bench_record(folder: Path) -> Outcome:
    out = _normals(_session(folder / "s")) / "normals.json"
    return _states(_record(out), simulated=False)


def _surface_of_normals(folder: Path) -> Outcome:
    _done("surface", _normals(_simulated(folder / "s")), "--out", folder / "surface")
    return _states(_record(folder / "surface" / "surface.json"))


def _chain_without_session(folder: Path) -> Outcome:
    """Normals, shape, surface, after the session was moved away."""
    normals = _normals(_simulated(folder / "s"))
    (folder / "s").rename(folder / "elsewhere")
    _done("detail", "separate", normals, "--out", folder / "detail")
    _done("surface", folder / "detail" / "shape.exr", "--out", folder / "surface")
    return _states(_record(folder / "surface" / "surface.json"))


def _page(folder: Path, **session: Any) -> str:
    out = _normals(_simulated(folder / "s", **session))
    _done("report", out, "--out", folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


def _head(page: str) -> str:
    return page.partition("<header>")[2].partition("</header>")[0]


def _report_head(folder: Path) -> Outcome:
    return _contains(_head(_page(folder)), [*_LABELS.values(), "SIMULATED", "2026-03-14"])


def _report_of_recording(folder: Path) -> Outcome:
    _done("report", _simulated(folder / "s"), "--out", folder / "report.html")
    page = (folder / "report.html").read_text(encoding="utf-8")
    return _contains(_head(page), [*_LABELS.values(), "SIMULATED", "2026-03-14"])


def _hostile_labels(folder: Path) -> Outcome:
    labels = {
        "object": "<script>alert(1)</script>\u202egnp.exe",
        "operator": '"><img src=x onerror=alert(2)>',
        "place": "\x07bell\u2066hidden\u2069",
        "notes": "&amp; " + "n" * 10_000,
        "rights": "</header></body>",
    }
    page = _page(folder, labels=labels)
    head = _head(page)
    raw = [
        sign for sign in ("\u202e", "\u2066", "\x07", "<img src=x", "alert(1)</s") if sign in head
    ]
    if raw or page.count("</header>") != 1 or page.count("</body>") != 1:
        return Outcome("wrong", f"markup or marks of direction in the page: {raw}")
    return _contains(head, ["&lt;script&gt;", "&lt;/header&gt;", "n" * 500])


def _export(folder: Path, layout: str, **session: Any) -> Path:
    source = folder / "s"
    if not source.exists():
        _simulated(source, **session)
    _done("capture", "export", source, "--format", layout, "--out", folder / layout)
    return folder / layout


@later
def _export_says_simulated(folder: Path, layout: str) -> Outcome:
    out = _export(folder, layout)
    image = next(path for path in sorted(out.iterdir()) if path.suffix in (".png", ".exr"))
    data = image.read_bytes().decode("latin-1")
    missing = [text for text in (_LABELS["object"], "SIMULATED") if text not in data]
    notes = json.loads((out / "recording.json").read_text(encoding="utf-8"))
    missing += [] if notes.get("origin") == "simulated" else ["recording.json"]
    record = _states(_record(out / "export.json"))
    if missing or record.kind != "right":
        return Outcome("wrong", f"{image.name} lacks {missing}; record: {record.text}")
    return Outcome("right", "image, recording.json and record")


@later
def _normals_of_export(folder: Path, layout: str) -> Outcome:
    out = _export(folder, layout)
    shutil.rmtree(folder / "s")
    words = [] if layout != "exr" else ["--lights", out / "lights.json"]
    return _states(_record(_normals(out, *words) / "normals.json"))


@later
def _imported_again(
    folder: Path, rig: Mapping[str, object], camera: Mapping[str, object]
) -> Outcome:
    _session(folder / "s", rig=rig, camera={**_CAMERA, **camera})
    _export(folder, "lp")
    _done("capture", "import", folder / "lp", "--out", folder / "once")
    _done("capture", "export", folder / "once", "--format", "diligent", "--out", folder / "two")
    _done("capture", "import", folder / "two", "--out", folder / "again")
    return _states(_record(_normals(folder / "again") / "normals.json"))


def _relightable(folder: Path) -> Outcome:
    out = _normals(_simulated(folder / "s"))
    _done("export", out, "--out", folder / "rti")
    info = (folder / "rti" / "info.json").read_text(encoding="utf-8")
    seen = _contains(info, [_LABELS["object"], _LABELS["rights"], '"simulated": true'])
    record = _states(_record(folder / "rti" / "export.json"))
    return seen if seen.kind != "right" else record


def _lights_of_another(folder: Path) -> Outcome:
    """The lights lie in the result of another recording: its object is not that of this one."""
    other = _normals(_simulated(folder / "s"))
    lights = other / "lights.lp"
    plain = folder / "plain"
    plain.mkdir()
    names = [f"{n:02d}.png" for n in range(_COUNT)]
    for name, image in zip(names, images(_LIGHTS), strict=True):
        cv2.imwrite(str(plain / name), np.round(image * 65535).astype(np.uint16))
    write_lp(lights, names, _LIGHTS)
    record = json.loads((other / "normals.json").read_text(encoding="utf-8"))
    record["outputs"]["lights"] = lights.name
    (other / "normals.json").write_text(json.dumps(record), encoding="utf-8")
    out = _normals(plain, "--lights", lights)
    _done("report", out, "--out", folder / "report.html")
    page = _head((folder / "report.html").read_text(encoding="utf-8"))
    claimed = _record(out / "normals.json") or "SIMULATED" in page or _LABELS["object"] in page
    return Outcome("wrong" if claimed else "right", f"claimed: {claimed or 'nothing'}")


def _journal_line(piece: bytes) -> dict[str, Any]:
    values: dict[str, Any] = json.loads(piece)
    del values["line_sha256"]
    return values


def _resealed(session: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change lines of a journal, and compute all hashes again."""
    from acquisition.session import GENESIS, encode_line
    from acquisition.session.layout import completion_mark

    previous, lines = GENESIS, []
    for piece in (session / "journal.jsonl").read_bytes().splitlines():
        values = _journal_line(piece)
        change(values)
        line, previous = encode_line(values, previous)
        lines.append(line)
    (session / "journal.jsonl").write_bytes(b"".join(lines))
    (session / "COMPLETE").write_bytes(completion_mark(b"".join(lines)))


@later
def _without_echo(folder: Path, role: str, led: int | None) -> Outcome:
    session = _session(folder / "s")

    def change(line: dict[str, Any]) -> None:
        if line["kind"] == "frame" and (line["role"], line["led"]) == (role, led):
            line["echo"] = None

    _resealed(session, change)
    verified, read = sgp("capture", "verify", session), sgp("inspect", session)
    if verified.code == 4 and read.code == 4 and "echo" in verified.out + verified.err:
        return Outcome("refused by name", read.message)
    return Outcome("wrong", f"verify exits with {verified.code}, inspect with {read.code}")


def _imported_without_echo(folder: Path) -> Outcome:
    answer = sgp("capture", "verify", _session(folder / "s", rig=None))
    return Outcome("wrong" if answer.code else "right", answer.message or "valid")


@later
def _clock(folder: Path, *lines: float, steps: bool = True, imported: bool = False) -> Outcome:
    """Lines at these hours after the start; those without a number follow two seconds apart."""

    def clock(line: int) -> timedelta:
        known = min(line, len(lines) - 1)
        return timedelta(hours=lines[known], seconds=2 * (line - known))

    session = _session(folder / "s", clock=clock, rig=None if imported else _RIG)
    answer = sgp("capture", "verify", session)
    codes = [code for code, _ in answer.notices if code == "clock-stepped"]
    if answer.code or len(codes) != steps:
        return Outcome("wrong", f"exit {answer.code}, {len(codes)} notices of a step")
    text = next((text for code, text in answer.notices if code == "clock-stepped"), "")
    return Outcome("applied and stated" if steps else "right", text or "no notice")


_NETWORK = """
import sys
from pathlib import Path
import numpy as np
from acquisition import DataError
from processing import NormalMap, super_resolve
n = np.zeros((24, 32, 3), np.float32); n[..., 2] = 1
try:
    super_resolve(NormalMap.from_vectors(n), 2, model=Path(sys.argv[1]))
except DataError as error:
    sys.exit(f"refused: {error}")
"""


def network_outcome(path: Path, seconds: float = 120.0) -> Outcome:
    """Use a network in a process of its own, and judge how the process ends."""
    try:
        ended = subprocess.run(
            [sys.executable, "-c", _NETWORK, str(path)],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Outcome("wrong", f"no end after {seconds:g} s")
    line = (ended.stderr.strip().splitlines() or [""])[-1]
    if ended.returncode == 0:
        return Outcome("right", "used")
    if ended.returncode == 1 and line.startswith("refused: ") and path.name in line:
        return Outcome("refused by name", line.removeprefix("refused: "))
    return Outcome("wrong", f"exit {ended.returncode}: {line}")


def shipped_network() -> Path:
    """Return the smallest network that comes with the program."""
    import processing

    return Path(processing.__file__).parent / "superres" / "models" / "superres-x2.onnx"


def write_network(path: Path, data: bytes) -> Path:
    """Write a network with a description whose hash agrees, as a person who made it would."""
    described = json.loads(shipped_network().with_suffix(".json").read_text(encoding="utf-8"))
    described["sha256"] = hashlib.sha256(data).hexdigest()
    path.write_bytes(data)
    path.with_suffix(".json").write_text(json.dumps(described), encoding="utf-8")
    return path


def mutated(data: bytes, seed: int) -> bytes:
    """Flip bits of the graph, cut it, or exchange bytes; the weights are mostly left alone."""
    rng = np.random.default_rng(seed)
    changed = bytearray(data)
    # The descriptions of nodes and shapes are texts between the weights, and at the end.
    words = [m.start() for m in re.finditer(rb"Conv|Relu|Concat|Add|float|output|input", data)]
    for _ in range(int(rng.integers(1, 6))):
        near = int(rng.choice(words)) + int(rng.integers(-24, 24))
        at = int(np.clip(near, 0, len(data) - 2))
        match seed % 3:
            case 0:
                changed[at] ^= 1 << int(rng.integers(8))
            case 1:
                changed[at], changed[at + 1] = changed[at + 1], changed[at]
            case 2:
                changed[at] = int(rng.integers(256))
    return bytes(changed[: int(rng.integers(1, len(data)))] if seed % 8 == 7 else changed)


@later
def _mutants(folder: Path, seeds: Iterable[int]) -> Outcome:
    data = shipped_network().read_bytes()
    bad = []
    for seed in seeds:
        found = network_outcome(write_network(folder / f"m{seed}.onnx", mutated(data, seed)))
        if found.kind == "wrong":
            bad.append(f"{seed}: {found.text}")
    return Outcome("wrong" if bad else "refused by name", "; ".join(bad) or "refused, or used")


def _field(number: int, content: bytes) -> bytes:
    """Return a field of a protobuf message that holds bytes."""
    size, length = len(content), b""
    while size > 127:
        length += bytes([size & 127 | 128])
        size >>= 7
    return bytes([number << 3 | 2]) + length + bytes([size]) + content


def _huge_network(folder: Path) -> Outcome:
    """A graph of a few hundred bytes that repeats its input ten million times."""

    def node(kind: str, inputs: list[str], output: str) -> bytes:
        named = b"".join(_field(1, name.encode()) for name in inputs)
        return _field(1, named + _field(2, output.encode()) + _field(4, kind.encode()))

    def value(number: int, name: str) -> bytes:
        shape = b"".join(_field(1, b"\x12\x01n") for _ in range(4))
        kind = _field(1, b"\x08\x01" + _field(2, shape))
        return _field(number, _field(1, name.encode()) + _field(2, kind))

    repeats = np.array([1, 1, 5000, 5000], "<i8").tobytes()
    constant = _field(5, b"\x08\x04\x10\x07" + _field(8, b"r") + _field(9, repeats))
    graph = node("Tile", ["x", "r"], "y") + _field(2, b"g") + constant
    graph += value(11, "x") + value(12, "y")
    data = b"\x08\x08" + _field(7, graph) + _field(8, b"\x0a\x00\x10\x0d")
    return network_outcome(write_network(folder / "huge.onnx", data))


def _copied_network(folder: Path) -> Outcome:
    return network_outcome(write_network(folder / "copy.onnx", shipped_network().read_bytes()))


@later
def _working_directory(folder: Path, names: Iterable[str], *start: str) -> Outcome:
    """Start the program in a folder of files with the names of modules."""
    for name in names:
        (folder / f"{name}.py").write_text(
            f"import sys\nsys.stderr.write('RAN {name}\\n')\n", encoding="utf-8"
        )
    root = shipped_network().parents[3]
    ended = subprocess.run(
        [sys.executable, *start, "-m", "sgp", "normals", "nothing", "--out", "out"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    ran = sorted(set(re.findall(r"RAN (\w+)", ended.stderr)))
    if ran or ended.returncode != 2:
        return Outcome("wrong", f"exit {ended.returncode}, ran: {', '.join(ran) or 'none'}")
    return Outcome("right", "none of them was run")


def _printed_lights(folder: Path) -> Outcome:
    """Print the report to paper: the table of lights must end before the edge."""
    program = next(filter(None, map(shutil.which, ("chromium", "chrome"))), None)
    reader = shutil.which("pdftotext")
    if program is None or reader is None:
        return Outcome("applied and stated", "not printed: there is no Chromium or no pdftotext")
    import acquisition

    errors = acquisition.LightErrors(
        covariances=np.tile(np.eye(3) * 1.2345, (_COUNT, 1, 1)),
        residual_px=np.full(_COUNT, 0.4321),
    )
    lights = acquisition.Lights(
        positions_mm=1000 * _LIGHTS,
        intensities=np.ones(_COUNT),
        ids=tuple(f"L{n:02d}" for n in range(_COUNT)),
        errors=errors,
    )
    session = _simulated(folder / "s")
    acquisition.write_lights(folder / "lights.json", lights, {})
    out = _normals(session, "--lights", folder / "lights.json", "--pixel-mm", "0.1")
    _done("report", out, "--out", folder / "report.html")
    pdf = folder / "report.pdf"
    words = ["--headless", "--no-sandbox", "--disable-gpu", f"--print-to-pdf={pdf}"]
    place = (folder / "report.html").resolve().as_uri()
    subprocess.run([program, *words, place], capture_output=True, timeout=120, check=True)
    words = [reader, "-bbox", str(pdf), "-"]
    found = subprocess.run(words, capture_output=True, text=True, check=True)
    width = float(re.findall(r'<page width="([\d.]+)"', found.stdout)[0])
    printed = re.findall(r'xMax="([\d.]+)" yMax="[\d.]+">([^<]*)<', found.stdout)
    beyond = [text for right, text in printed if float(right) > width]
    # The residuals of the lights: a print leaves out what is cut.
    rows = sum(text == "0.432" for _, text in printed)
    if beyond or rows < _COUNT:
        return Outcome("wrong", f"{len(beyond)} words beyond the edge, {rows} of {_COUNT} rows")
    return Outcome("right", f"all {len(printed)} words within {width:g} pt")


def _options_given(folder: Path) -> Outcome:
    out = _normals(_simulated(folder / "s"), "--downscale", "2")
    _done("report", out, "--out", folder / "report.html")
    page = (folder / "report.html").read_text(encoding="utf-8")
    listed = page.partition("<summary>Parameters</summary>")[2].partition("</details>")[0]
    if ">downscale<" not in listed:
        return Outcome("wrong", "the given option is not listed")
    others = [name for name in ("crop", "radius_mm", "exclude", "flat") if f">{name}<" in listed]
    return Outcome("wrong" if others else "right", f"not given: {', '.join(others) or 'none'}")


CASES = cases(
    3,
    (
        ("normals_of_simulated", "the record has the labels", _normals_record),
        ("surface_of_normals", "the record has the labels", _surface_of_normals),
        ("report_head", "labels and SIMULATED in the head", _report_head),
        *(
            (f"export_{layout}", "labels and SIMULATED", _export_says_simulated(layout))
            for layout in ("lp", "diligent", "exr", "alicevision")
        ),
        ("relightable_image", "labels and SIMULATED in info.json", _relightable),
        ("printed_lights", "no word beyond the edge", _printed_lights),
        ("options_given", "given options only", _options_given),
        ("mutated_networks", "refused", _mutants(_STRUCK)),
        ("python_m_sgp", "not run", _working_directory(["sgp"])),
        ("no_echo", "damage", _without_echo("light", 2)),
        ("clock_years_on", "a notice", _clock(0, 0.01, 40_000)),
    ),
    (
        ("normals_of_bench", "labels, not simulated", _bench_record),
        ("moved_session", "labels by the records", _chain_without_session),
        ("report_of_recording", "labels in the head", _report_of_recording),
        ("hostile_labels", "escaped", _hostile_labels),
        ("normals_of_lp", "labels of recording.json", _normals_of_export("lp")),
        ("normals_of_exr", "labels of recording.json", _normals_of_export("exr")),
        ("imported_again", "simulated", _imported_again({**_RIG, "driver": "simulated"}, _VIRTUAL)),
        (
            "virtual_board_imported",
            "simulated, though the camera is not virtual",
            _imported_again({**_RIG, "board": "sgp-virtual-board"}, {}),
        ),
        ("lights_of_another", "no foreign object", _lights_of_another),
        ("import_has_no_echo", "valid", _imported_without_echo),
        ("clock_back", "a notice", _clock(0, 0.01, -3)),
        ("clock_of_1970", "a notice", _clock(0, 0.01, -24 * 20_000, 0.02, 0.03)),
        ("pause_of_a_night", "no notice", _clock(0, 0.01, 14, steps=False)),
        ("clock_corrected_by_seconds", "no notice", _clock(0, 0.01, 0.0095, steps=False)),
        ("network_of_a_few_bytes", "refused, bounded", _huge_network),
        ("network_copied", "used", _copied_network),
        (
            "other_modules_there",
            "not run",
            _working_directory(("rig", "numpy", "cv2", "acquisition", "json")),
        ),
        (
            "typing_there",
            "not run",
            _working_directory(("typing", "signal", "contextlib", "pathlib")),
        ),
        ("python_P_m_sgp", "not run", _working_directory(("sgp", "rig", "typing"), "-P")),
    ),
)
