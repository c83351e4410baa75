"""What the operator reads when a recording ends early."""

import shutil
from pathlib import Path

from sgp.sessions import CaptureTalk, ResumeCommand
from tests.cases import cases

GOLDEN = Path(__file__).parents[1] / "acquisition" / "golden_session_3"


def unfinished(folder: Path, lines: int | None = None) -> Path:
    """Copy a session without its mark, with its first journal lines only.

    The first 4 list two frames, but the file of one has another name since later lines.
    """
    shutil.copytree(GOLDEN, folder)
    (folder / "COMPLETE").unlink()
    journal = folder / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:lines]))
    return folder


@cases(
    ("lines", "damaged", "said"),
    {
        "some missing": (
            4, False, "1 frame is intact, 7 are missing; the LEDs are off; `capture resume "
            "{folder}` takes the missing frames",
        ),
        "also damaged": (
            4, True, "1 frame is intact, 7 are missing; the LEDs are off; `capture resume "
            "{folder} --retake-damaged` takes the missing and damaged frames",
        ),
        "none missing": (
            None, False, "all frames are recorded; the LEDs are off; `capture resume {folder}` "
            "completes the session",
        ),
        "only damaged": (
            None, True, "all frames are recorded; the LEDs are off; `capture resume {folder} "
            "--retake-damaged` takes the damaged frames",
        ),
    },
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


def test_a_device_that_is_gone_is_reported_in_one_line_and_so_is_its_return(tmp_path, capsys):
    talk = CaptureTalk(ResumeCommand(tmp_path))
    talk.on_event("device_lost", {"device": "camera", "reason": "c7 no longer answers"})
    talk.on_event("device_returned", {"device": "camera", "seconds": 4.2})
    assert capsys.readouterr().err.splitlines() == [
        "waiting for the camera: c7 no longer answers",
        "the camera is back after 4 s: the recording continues",
    ]
