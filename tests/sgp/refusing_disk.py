"""A program that runs commands on a disk that is full or read-only; see test_cli_disk.py.

refusing_disk.py KIND DISK COMMANDS   (JSON: a list of command lines)

It runs in its own mount namespace (``unshare -rm``). DISK is a folder. It is remounted as a full
file system of 64 kB, or read-only. The program prints one JSON list of command, exit code, stdout
and stderr.
"""

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path

KIND, DISK = sys.argv[1], Path(sys.argv[2])


def mount(*words: object) -> None:
    subprocess.run(["mount", *map(str, words)], check=True)


def main() -> None:
    from sgp.app import build, run

    if KIND == "full":
        mount("-t", "tmpfs", "-o", "size=64k", "none", DISK)
        with contextlib.suppress(OSError), (DISK / "ballast").open("wb", buffering=0) as file:
            while True:
                file.write(b"x" * 4096)
    else:
        mount("--bind", DISK, DISK)
        mount("-o", "remount,bind,ro", DISK)
    ended = []
    for words in json.loads(sys.argv[3]):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = run(build(), words)
        ended.append([" ".join(words[:3]), code, out.getvalue(), err.getvalue()])
    sys.stdout.write(json.dumps(ended))


if __name__ == "__main__":
    main()
