"""What the operator reads when a recording ends early."""

import shutil
from pathlib import Path

import pytest

from sgp.sessions import CaptureTalk, ResumeCommand

GOLDEN = Path(__file__).parents[1] / "acquisition" / "golden_session_3"


def unfinished(folder: Path, lines: int | None = None) -> Path:
    """Copy a session without its mark, with its first journal lines only."""
    shutil.copytree(GOLDEN, folder)
    (folder / "COMPLETE").unlink()
    journal = folder / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:lines]))
    return folder


@pytest.mark.parametrize(
    ("lines", "damaged", "said"),
    [
        pytest.param(
            4, False, "2 frames are intact, 7 are missing; the LEDs are off; `capture resume "
            "{folder}` takes the missing frames", id="some missing",
        ),
        pytest.param(
            4, True, "2 frames are intact, 7 are missing; the LEDs are off; `capture resume "
            "{folder} --retake-damaged` takes the missing and damaged frames", id="also damaged",
        ),
        pytest.param(
            None, False, "all frames are recorded; the LEDs are off; `capture resume {folder}` "
            "completes the session", id="none missing",
        ),
        pytest.param(
            None, True, "all frames are recorded; the LEDs are off; `capture resume {folder} "
            "--retake-damaged` takes the damaged frames", id="only damaged",
        ),
    ],
)  # fmt: skip
def test_the_state_of_an_unfinished_session(tmp_path, capsys, lines, damaged, said):
    folder = unfinished(tmp_path / "s", lines)
    talk = CaptureTalk(ResumeCommand(folder))
    if damaged:
        talk.on_damage("D_100us.tif")
    talk.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"{folder}: incomplete, {said.format(folder=folder)}"
    )
