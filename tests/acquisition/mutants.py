"""Sessions with one changed value and recomputed hashes, and all readers applied to them."""

from __future__ import annotations

import hashlib
import json
import random
import shutil
import tomllib
from collections.abc import Iterable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import tomli_w

from acquisition import (
    DataError,
    MissingPathError,
    Session,
    StorageError,
    read_source,
    resume,
    verify_session,
)
from acquisition.engine import check_resume, rehearse
from acquisition.exports import prepare_export
from acquisition.session import GENESIS, compact_session, damaged_frames
from rig import RigError
from sgp.sessions import describe, write_session_sheet
from tests.acquisition.fake_bench import Bench, rig_on

LAYOUTS = {"diligent": "raw", "lp": "linear", "exr": "raw", "alicevision": "linear"}
DECLARED = (DataError, MissingPathError, StorageError, RigError)

NESTED: Any = 0
for _ in range(400):
    NESTED = [NESTED]

VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    1,
    -1,
    7,
    2**31,
    2**63,
    2**64,
    10**400,
    0.5,
    -0.5,
    1e300,
    5e-324,
    float("nan"),
    float("inf"),
    "",
    "x",
    "3",
    "\ud800",
    "a\x00b",
    "frames/L00_E0.tif",
    "frames/l00_e0.TIF",
    "../../etc/passwd",
    "z" * 5000,
    [],
    [1],
    [None],
    ["x"],
    {},
    {"a": 1},
    {"99": 1},
    NESTED,
)


def rows_of(folder: Path) -> list[dict[str, Any]]:
    rows = [json.loads(line) for line in (folder / "journal.jsonl").read_bytes().splitlines()]
    for row in rows:
        del row["line_sha256"]
    return rows


def seal(folder: Path, rows: list[dict[str, Any]], *, complete: bool | None = None) -> None:
    """Write the journal, and COMPLETE if it exists or is requested."""
    rows[0]["session_toml_sha256"] = hashlib.sha256(
        (folder / "session.toml").read_bytes()
    ).hexdigest()
    data, previous = b"", GENESIS
    for row in rows:
        text = json.dumps(row, separators=(",", ":"))[:-1].encode("ascii")
        previous = hashlib.sha256(previous.encode() + text).hexdigest()
        data += text + f',"line_sha256":"{previous}"}}\n'.encode()
    (folder / "journal.jsonl").write_bytes(data)
    mark = folder / "COMPLETE"
    if complete if complete is not None else mark.exists():
        mark.write_text(f"{hashlib.sha256(data).hexdigest()}  journal.jsonl\n")
    else:
        mark.unlink(missing_ok=True)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value inside a value."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield (*path, key)
        if isinstance(inner, dict | list):
            yield from places(inner, (*path, key))


def mutate(document: Any, dice: random.Random, others: list[Any]) -> str:
    """Change one value of a document in place; return a description of the change."""
    path = dice.choice(list(places(document)))
    inside = document
    for key in path[:-1]:
        inside = inside[key]
    where, key = ".".join(map(str, path)), path[-1]
    match dice.randrange(10):
        case 0 if isinstance(inside, dict):
            del inside[key]
            return f"{where} deleted"
        case 1 if isinstance(inside, dict):
            inside["surprise"] = deepcopy(dice.choice(VALUES))
            return f"{where}: an additional key"
        case 2 | 3:
            # The value of the same key in another line, which looks plausible.
            other = dice.choice(others)
            try:
                for step in path:
                    other = other[step]
            except (KeyError, IndexError, TypeError):
                other = dice.choice(VALUES)
            inside[key] = deepcopy(other)
        case 4 if isinstance(inside[key], int | float) and not isinstance(inside[key], bool):
            inside[key] += dice.choice((-1, 1, 0.5, 1e6))
        case _:
            inside[key] = deepcopy(dice.choice(VALUES))
    return f"{where} = {ascii(inside[key])[:60]}"


def mutant(folder: Path, dice: random.Random) -> str:
    """Change one value of a line or of ``session.toml``; return a description of the change."""
    rows = rows_of(folder)
    if dice.random() < 0.25:
        path = folder / "session.toml"
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        said = mutate(document, dice, [document])
        try:
            path.write_text(tomli_w.dumps(document), encoding="utf-8")
        except (TypeError, UnicodeEncodeError, RecursionError):
            said = "nothing: TOML cannot store this value"
        seal(folder, rows)
        return f"session.toml: {said}"
    number = dice.randrange(1, len(rows))
    said = mutate(rows[number], dice, rows)
    seal(folder, rows)
    return f"line {number + 1}: {said}"


def read_by_all(
    folder: Path,
    work: Path,
    *,
    layouts: Iterable[str] = LAYOUTS,
    retakes: Iterable[bool] = (False, True),
) -> list[str]:
    """Apply every reader to a session; return the violations.

    The session is exported in some layouts and resumed with some values of ``retake_damaged``. Each
    reader may raise its declared errors. An error in the journal that one reader finds must be
    found by all.
    """
    wrong: list[str] = []
    refused: dict[str, bool] = {}

    def tried(name: str, call: Any) -> Any:
        try:
            result = call()
        except DECLARED as error:
            refused[name] = True
            if "\n" in str(error):
                wrong.append(f"{name}: more than one line: {error}")
            return None
        except Exception as error:  # noqa: BLE001 - any other error is a violation
            wrong.append(f"{name}: {type(error).__name__}: {error}"[:300])
            return None
        refused[name] = False
        return result

    session = tried("open", lambda: Session.open(folder))
    found = tried("verify", lambda: verify_session(folder))
    source = tried("source", lambda: read_source(folder))
    tried("damaged", lambda: damaged_frames(folder))
    if session is None:
        if found is not None and found.ok:
            wrong.append("verify reports no problem in a session that cannot be opened")
        if refused.get("source") is False:
            wrong.append("source reads a session that cannot be opened")
    else:
        tried("info", lambda: describe(session))
        tried("sheet", lambda: write_session_sheet(work / "sheet.png", session))
    if source is not None:
        tried("frames", lambda: [frame.read() for frame in source.frames])
    for layout in layouts:
        out, values = work / layout, LAYOUTS[layout]
        tried(layout, lambda: prepare_export(folder, layout, values=values).write(out))  # noqa: B023
    copy = work / "compacted"
    shutil.copytree(folder, copy)
    tried("compact", lambda: compact_session(copy))
    for option in retakes:
        copy = work / f"resumed-{option}"
        shutil.copytree(folder, copy)
        with rig_on(Bench()) as rig:
            checked = tried("check_resume", lambda: check_resume(rig, copy))  # noqa: B023
            if checked is not None:
                tried("rehearse", lambda: rehearse(rig, checked[1], shots=checked[2]))  # noqa: B023
            done = tried("resume", lambda: resume(rig, copy, retake_damaged=option))  # noqa: B023
        if done is not None and not verify_session(copy).ok:
            wrong.append(f"resume (retake {option}) completed a damaged session")
    if found is not None and found.ok and session is not None:
        wrong += [
            f"{name} refuses a session that verifies"
            for name in ("open", "source", "frames", "info", "compact")
            if refused.get(name)
        ]
    return wrong
