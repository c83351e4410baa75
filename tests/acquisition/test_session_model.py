"""Random series of calls of the session store, compared with a plain model of it."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from acquisition import CapturePlan, DataError, Session, StorageError, verify_session
from acquisition.session import SessionWriter
from rig.arrays import UInt16
from tests.acquisition.small_session import manifest

PLAN = CapturePlan(repeat=False, leds=(0, 1, 2), exposures_us=(100.0, 200.0), dark=False)
SHOTS = PLAN.shots()
SHAPE = (4, 6)


def picture(number: int) -> UInt16:
    return np.full(SHAPE, number % 4096, np.uint16)


class SessionStore(RuleBasedStateMachine):
    """The model: which picture counts for each shot, what is damaged, and what is open."""

    def __init__(self) -> None:
        super().__init__()
        self.top = Path(tempfile.mkdtemp(prefix="sgp-model-"))
        self.folder = self.top / "session"
        self.writer: SessionWriter | None = None
        # Picture of each take that counts, by the index of its shot; those of damaged files.
        self.counts: dict[int, int] = {}
        self.damaged: dict[int, int] = {}
        self.recorded = 0
        self.pictures = 0
        self.events: list[str] = []
        self.complete = False

    @initialize()
    def create(self) -> None:
        self.writer = SessionWriter.create(self.folder, manifest(SHAPE, 12, plan=PLAN))

    @property
    def open(self) -> bool:
        return self.writer is not None

    @precondition(lambda self: self.writer is not None)
    @rule(index=st.integers(0, len(SHOTS) - 1), rejected=st.booleans())
    def take(self, index: int, rejected: bool) -> None:
        assert self.writer is not None
        self.pictures += 1
        status: Any = "rejected" if rejected else "ok"
        line = self.writer.write_frame(SHOTS[index], picture(self.pictures), status=status)
        assert line.status == status
        self.recorded += 1
        if not rejected:
            self.counts[index] = self.pictures
            self.damaged.pop(index, None)

    @precondition(lambda self: self.writer is not None)
    @rule(word=st.sampled_from(["paused", "noted"]))
    def note(self, word: str) -> None:
        assert self.writer is not None
        self.writer.write_event(word, reason="a test", waiting=1)
        self.events.append(word)

    @precondition(lambda self: self.writer is not None)
    @rule()
    def refuse_a_second_writer(self) -> None:
        with pytest.raises(StorageError, match="another process"):
            SessionWriter.reopen(self.folder)

    @precondition(lambda self: self.writer is not None)
    @rule(torn=st.integers(0, 30))
    def die(self, torn: int) -> None:
        """End without `complete`, in the middle of a line or of a frame."""
        assert self.writer is not None
        self.writer.close()
        self.writer = None
        with (self.folder / "journal.jsonl").open("ab") as journal:
            journal.write(b'{"kind":"frame","seq":99,"time'[:torn])
        if torn % 2:
            (self.folder / "frames" / ".part-L00_E0.tif").write_bytes(b"half")
        if torn % 3 == 0:
            (self.folder / "frames" / "L77_E0.tif").write_bytes(b"whole, but without a line")

    @precondition(lambda self: self.writer is None and not self.complete and not self.damaged)
    @rule()
    def reopen(self) -> None:
        self.writer = SessionWriter.reopen(self.folder)
        self.events.append("reopened")

    @precondition(lambda self: self.writer is None and self.counts)
    @rule(data=st.data())
    def damage(self, data: st.DataObject) -> None:
        index = data.draw(st.sampled_from(sorted(self.counts)))
        path = self._frame(index).path
        if data.draw(st.booleans()):
            path.unlink()
        else:
            path.write_bytes(path.read_bytes()[:-1] + b"\xff")
        self.damaged[index] = self.counts.pop(index)

    @precondition(lambda self: self.writer is None and self.damaged)
    @rule()
    def set_aside(self) -> None:
        self.writer = SessionWriter.reopen(self.folder, set_aside_damaged=True)
        self.events += ["reopened", *["set_aside"] * len(self.damaged)]
        self.recorded -= len(self.damaged)
        self.damaged.clear()
        self.complete = False

    @precondition(lambda self: self.writer is not None)
    @rule()
    def finish(self) -> None:
        assert self.writer is not None
        if len(self.counts) < len(SHOTS):
            with pytest.raises(DataError, match="missing"):
                self.writer.complete()
        else:
            self.writer.complete()
            self.writer, self.complete = None, True

    @invariant()
    def readers_agree(self) -> None:
        if not self.folder.exists():
            return
        session = Session.open(self.folder, damaged_frames=True)
        present = {**self.counts, **self.damaged}
        assert {SHOTS.index(shot) for shot in session.missing} == set(range(6)) - set(present)
        assert session.complete == self.complete
        assert [line.event for line in session.events] == self.events
        assert len(session.recorded) == self.recorded
        for index, number in self.counts.items():
            np.testing.assert_array_equal(self._frame(index).read(), picture(number))

    @invariant()
    def verify_tells_the_truth(self) -> None:
        if not self.folder.exists() or self.open:
            return
        found = verify_session(self.folder)
        assert len(found.damaged) == len(self.damaged)
        assert found.ok == (not self.damaged)
        assert found.complete == self.complete

    def _frame(self, index: int) -> Any:
        session = Session.open(self.folder, damaged_frames=True)
        (frame,) = [one for one in session.frames if one.line.key == SHOTS[index].key]
        return frame

    def teardown(self) -> None:
        if self.writer is not None:
            self.writer.close()
        shutil.rmtree(self.top)


class TestSessionStore(SessionStore.TestCase):  # type: ignore[name-defined,misc]
    settings = settings(max_examples=8, stateful_step_count=25)


@pytest.mark.slow
class TestSessionStoreForLong(SessionStore.TestCase):  # type: ignore[name-defined,misc]
    settings = settings(max_examples=60, stateful_step_count=25)
