"""The output folder of the demo, and which files in it were written by a demo."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import acquisition
import rig
from sgp.cli.exit import UsageError
from sgp.results.hashes import sha256
from sgp.results.output import check_folder, locked
from sgp.results.result import dumps

MARK = ".made-by-sgp-demo"
# Files and folders that a demo writes; a later demo replaces only these.
_MADE = (
    "calibration",
    "recording",
    "normals",
    "detail",
    "surface",
    "camera.json",
    "lights.json",
    "overview.png",
    "report.html",
    "summary.json",
)


class DemoFolder:
    """The output folder of a running demo.

    A mark file in it lists the files of the finished stages with their hashes, and the files that
    the current stage writes. From it, the next demo can distinguish the files of a demo that was
    killed from other files.

    Parameters
    ----------
    out
        The folder, locked by `claimed`.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._known: dict[str, str] = {}
        self._at_work: tuple[str, ...] = ()

    def begin(self, *names: str) -> None:
        """Begin a stage that writes these files or folders; this finishes the stage before it."""
        self._finish_stage()
        self._at_work = names
        self._write()

    def finish(self) -> None:
        """Record that the last stage has finished."""
        self._finish_stage()
        self._write()

    def _finish_stage(self) -> None:
        for path in _files(self._out, self._at_work):
            self._known[str(path.relative_to(self._out))] = sha256(path)
        self._at_work = ()

    def _write(self) -> None:
        mark = {"files": self._known, "unfinished": list(self._at_work)}
        acquisition.write_durably(self._out / MARK, dumps(mark).encode())


@contextmanager
def claimed(out: Path, *, force: bool) -> Iterator[DemoFolder]:
    """Lock a folder for a demo and remove the files of earlier demos.

    Raises
    ------
    UsageError
        If the folder contains other files and ``force`` is not given, if a file that the demo would
        replace was not written by a demo or was changed since, or if another demo is running in
        the folder.
    """
    existed = out.is_dir()
    if not existed:
        check_folder(out, force=force)
        acquisition.make_folder(out)
    other = f"another demo is running in {out}: wait until it has ended, or choose another --out"
    with locked(out, other):
        _make_room(out, force=force)
        folder = DemoFolder(out)
        folder.begin()
        try:
            yield folder
        finally:
            folder.finish()


def _make_room(out: Path, *, force: bool) -> None:
    """Remove the files of an earlier demo; refuse other files with the same names."""
    mark = out / MARK
    acquisition.files.remove_part_files(out)
    if not mark.is_file() or mark.is_symlink():
        check_folder(out, force=force)
    hashes, at_work = _read(mark)
    for path in _files(out, _MADE):
        name = path.relative_to(out)
        own = name.parts[0] in at_work or (
            not path.is_symlink() and hashes.get(str(name)) == sha256(path)
        )
        if path.is_symlink() or not own:
            raise UsageError(
                f"{path} was not written by a demo, or was changed since: move it away, or choose "
                "another --out"
            )
    for top in _MADE:
        path = out / top
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _files(out: Path, names: tuple[str, ...]) -> list[Path]:
    """Return the files and links under some names, without following links."""
    paths = []
    for name in names:
        top = out / name
        below = [] if top.is_symlink() or not top.is_dir() else top.rglob("*")
        paths += [path for path in (top, *below) if path.is_symlink() or path.is_file()]
    return paths


def _read(mark: Path) -> tuple[Mapping[str, str], tuple[str, ...]]:
    """Return the hashes in a mark file, and the files of the stage that did not finish."""
    try:
        content = rig.files.parse_json(rig.read_bounded(mark))
        files, at_work = content.get("files", content), content.get("unfinished", [])
        return {str(name): str(digest) for name, digest in files.items()}, tuple(map(str, at_work))
    except (FileNotFoundError, rig.UnreadableError, AttributeError, TypeError):
        return {}, ()
