"""A program that runs commands and plants links at every name just before it is written.

planting.py ROOT VICTIMS KINDS COMMANDS   (JSON: a list of command lines)

Python reports every file that it is about to open, and every rename, to an audit hook. Just before
a name below ROOT is written for the first time, the hook creates something there, of the KINDS in
turn: ``link`` (a link to a separate victim), ``dangling`` (a link to a file that must not be
created), ``hard`` (another name of a victim) or ``pipe``. The program prints one JSON object: exit
codes, planted names, opens for writing that would have followed a link, and files that appeared
without a rename or open that the hook saw, for example files written by a C library.
"""

import contextlib
import io
import json
import os
import sys
import threading
from pathlib import Path

ROOT, VICTIMS, KINDS = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3].split()
COMMANDS = json.loads(sys.argv[4])

planted: list[str] = []
followed: list[str] = []
made: set[str] = set()
_seen: set[tuple[str, str]] = set()
# Of each thread: files may be written at the same time.
_here = threading.local()
_one_at_a_time = threading.Lock()


def plant(path: str) -> None:
    victim, kind = VICTIMS / str(len(planted)), KINDS[len(planted) % len(KINDS)]
    planted.append(path)
    if os.path.lexists(path):
        os.unlink(path)
    if kind == "pipe":
        os.mkfifo(path)
        return
    if kind != "dangling":
        victim.write_bytes(b"mine")
    if kind == "hard":
        os.link(victim, path)
    else:
        os.symlink(victim, path)


def watch(event: str, values: tuple[object, ...]) -> None:
    if getattr(_here, "busy", False) or event not in ("open", "os.rename"):
        return
    place = values[1] if event == "os.rename" else values[0]
    if not isinstance(place, str | bytes | os.PathLike):
        return
    path = os.path.abspath(os.fsdecode(place))
    if not path.startswith(f"{ROOT}/"):
        return
    _here.busy = True
    try:
        if event == "os.rename":
            made.add(path)
            if os.path.isdir(path) or os.path.isdir(os.fsdecode(values[0])):
                return
        else:
            flags = values[2]
            if not flags & (os.O_WRONLY | os.O_RDWR):
                return
            if not flags & os.O_NOFOLLOW:
                followed.append(path)
            if not flags & os.O_CREAT:
                return
            if not flags & os.O_EXCL:
                followed.append(path)
            made.add(path)
        with _one_at_a_time:
            if (event, path) not in _seen:
                _seen.add((event, path))
                plant(path)
    finally:
        _here.busy = False


def files() -> set[str]:
    return {str(p) for p in ROOT.rglob("*") if p.is_symlink() or not p.is_dir()}


def main() -> None:
    from sgp.app import build, run

    before = files()
    sys.addaudithook(watch)
    ended = []
    for words in COMMANDS:
        if words[0] == "python":  # changes the files between two commands
            _here.busy = True
            exec(words[1], {"ROOT": ROOT})
            _here.busy = False
            before |= files()
            continue
        errors = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            code = run(build(), words)
        ended.append([" ".join(words[:3]), code, errors.getvalue()[-600:]])
        if code != 0:
            break
    unseen = sorted(files() - before - made)
    found = {"ended": ended, "planted": planted, "followed": followed, "unseen": unseen}
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
