"""Defects of capture, rig and session code that a recording in virtual time must reveal."""

from __future__ import annotations

from tests.mutation.planted import Planted

_LINE, _BOARD = "rig/board/line.py", "rig/board/board.py"
_SHOOTING, _SEQUENCE = "rig/shooting/shooting.py", "rig/shooting/sequence.py"
_PROOF, _OFF, _RIG = "rig/shooting/frame_proof.py", "rig/shooting/lights_off.py", "rig/rigs/rig.py"
_RUN = "acquisition/engine/recording_run.py"
_LOOP = "acquisition/engine/recording_loop.py"
_QUEUE, _ORDER = "acquisition/engine/write_queue.py", "acquisition/engine/shot_order.py"
_STORAGE, _PARTS = "acquisition/files/storage.py", "acquisition/files/part_files.py"
_WRITER, _JOURNAL = "acquisition/session/writer.py", "acquisition/session/journal_file.py"
_FILE, _ASIDE = "acquisition/session/frame_file.py", "acquisition/session/files_aside.py"
_OPENING, _PROOFS = "acquisition/session/opening.py", "acquisition/session/frame_proofs.py"
_OPEN, _LIGHT = "acquisition/session/open_shots.py", "acquisition/session/light_proof.py"
_VERIFY, _FRAMES = "acquisition/session/verify.py", "acquisition/session/journal_frames.py"
_LINES, _CHECK = "acquisition/session/journal.py", "acquisition/session/frame_check.py"

DEFECTS = (
    # The board and its line.
    Planted(
        "OFF reports the LED of the command before",
        _BOARD,
        "        return BoardEcho(outcome.seq, outcome.led(0))",
        '        was, self._was = getattr(self, "_was", None), outcome.led(0)\n'
        "        return BoardEcho(outcome.seq, was)",
    ),
    # Shots.
    Planted(
        "any frame is that of the shot",
        _SHOOTING,
        "    if frame.frame_id != expected:\n",
        "    if frame.frame_id > expected:\n",
    ),
    Planted(
        "the LED is not checked after the frame",
        _SHOOTING,
        "    _check_lit(board, led, echo.led, ends_s, alive)\n    return Shot(frame, led, echo)",
        "    return Shot(frame, led, echo)",
    ),
    Planted(
        "the echo states the requested LED",
        _SHOOTING,
        "    _check_lit(board, led, echo.led, ends_s, alive)\n    return Shot(frame, led, echo)",
        "    return Shot(frame, led, BoardEcho(echo.seq, led))",
    ),
    Planted(
        "OFF before the frame has arrived",
        _SHOOTING,
        "    frame = camera.fetch(frame_id, timeout_s, alive)\n"
        '    check_id(camera, frame, frame_id, f"the shot',
        "    echo = board.off()\n    frame = camera.fetch(frame_id, timeout_s)\n"
        '    return Shot(frame, led, echo)\n    check_id(camera, frame, frame_id, f"the shot',
    ),
    Planted(
        "a flash may end before the exposure",
        _SHOOTING,
        "    if report.cut_off or (lit_us < times.needed_us and not seen):",
        "    if report.cut_off:",
    ),
    Planted(
        "the frames of a sequence are shifted by one",
        _SEQUENCE,
        "            frame = camera.fetch(ids[index], left_s, alive)",
        "            frame = camera.fetch(ids[max(0, index - 1)], left_s, alive)",
    ),
    Planted(
        "the spacing of frames is not checked",
        _PROOF,
        "            if abs(apart_us - pulses_us) > CLOCK_JITTER_US + CLOCK_SHARE * pulses_us:",
        "            if apart_us < 0:",
    ),
    Planted(
        "the time between flashes is not checked",
        _PROOF,
        "        if off_us > min(self._open_us(since_us), times.margin_us):",
        "        if off_us > 1e9:",
    ),
    Planted(
        "the first frames of a sequence are not held back",
        _SEQUENCE,
        "        if index > 1:\n",
        "        if held_back:\n",
    ),
    # The loop of a recording.
    Planted(
        "rejected frames count",
        _LOOP,
        '            status="ok" if rejected is None else "rejected",',
        '            status="ok",',
    ),
    Planted(
        "rejected shots are not taken again",
        _LOOP,
        "                self._todo.again(stored.shot)\n",
        "",
    ),
    Planted(
        "the rest of a sequence is forgotten",
        _LOOP,
        "                    break\n        self._todo.put_back(group)\n",
        "                    break\n",
    ),
    Planted(
        "the rest of a sequence is forgotten when a device is gone",
        _LOOP,
        "            self._todo.put_back(group)\n            raise\n",
        "            raise\n",
    ),
    Planted(
        "the session is completed although a write failed",
        _QUEUE,
        "            if not results and self._error is not None:\n"
        "                raise self._error",
        "",
    ),
    # Files.
    Planted("no fsync of a file", _STORAGE, "            filesystem.fsync(part.descriptor)\n", ""),
    Planted(
        "no fsync of a folder after a rename",
        _STORAGE,
        "            sync_folder(path.parent)\n",
        "",
    ),
    Planted(
        "rename before fsync",
        _STORAGE,
        "            filesystem.fsync(part.descriptor)\n            check_publishing()",
        "            check_publishing()",
    ),
    Planted(
        "a short write is complete",
        _STORAGE,
        "        view = view[filesystem.write(descriptor, view) :]",
        "        filesystem.write(descriptor, view)\n        view = view[len(view) :]",
    ),
    Planted(
        "no fsync of the journal",
        _STORAGE,
        "        write_whole(descriptor, data)\n        filesystem.fsync(descriptor)",
        "        write_whole(descriptor, data)",
    ),
    Planted(
        "no fsync of the folder of a new folder",
        _STORAGE,
        "            with suppress(PermissionError):\n                sync_folder(parent)",
        "            pass",
    ),
    Planted(
        "no lock on the session",
        _STORAGE,
        "            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)\n"
        "        except BlockingIOError:\n            files",
        "            pass\n        except BlockingIOError:\n            files",
    ),
    # The session.
    Planted(
        "the line before the frame",
        _WRITER,
        "            stored = store_frame(path, pixels)\n"
        '            values |= {"file": f"{FRAMES}/{path.name}", **asdict(stored)}\n'
        "            before_line()\n"
        "            line = self._append(FrameLine, values)\n",
        '            early = path.with_name(f".early-{path.name}")\n'
        "            stored = store_frame(early, pixels)\n"
        '            values |= {"file": f"{FRAMES}/{path.name}", **asdict(stored)}\n'
        "            before_line()\n"
        "            line = self._append(FrameLine, values)\n"
        "            filesystem.rename(early, path)\n",
    ),
    Planted(
        "lines after a failed line",
        _JOURNAL,
        "        self._unsure = True\n",
        "",
    ),
    Planted(
        "the old lines are not kept",
        _JOURNAL,
        "        write_durably(path, old.text + sealed)",
        "        write_durably(path, sealed)",
    ),
    Planted(
        "the torn line is kept",
        _JOURNAL,
        "        write_durably(path, old.text + sealed)",
        "        write_durably(path, old.text + old.torn + sealed)",
    ),
    Planted(
        "the chain begins again after a resume",
        _JOURNAL,
        "        file._seq, file._previous = len(old.lines), old.last_sha256\n",
        "        file._seq = len(old.lines)\n",
    ),
    Planted(
        "the hash without the header",
        _FILE,
        "hashlib.sha256(header), hashlib.sha256()",
        "hashlib.sha256(), hashlib.sha256()",
    ),
    Planted(
        "a take overwrites an earlier one",
        _FILE,
        "                if path.name not in self._taken and not path.exists():",
        "                if True:",
    ),
    Planted(
        "rejected frames fulfil the plan",
        _OPEN,
        '            if isinstance(line, FrameLine) and line.status == "ok":',
        "            if isinstance(line, FrameLine):",
    ),
    Planted(
        "files without a line are deleted",
        _ASIDE,
        "        _move(path, target)\n    with disk(frames",
        "        filesystem.unlink(path)\n    with disk(frames",
    ),
    Planted(
        "a file is set aside before its event",
        _ASIDE,
        "        lines.append(journal.append(EventLine, "
        '{"event": SET_ASIDE, "details": details}))\n        if there:\n'
        "            _move(frame.path, kept)",
        "        if there:\n            _move(frame.path, kept)\n        lines.append("
        'journal.append(EventLine, {"event": SET_ASIDE, "details": details}))',
    ),
    Planted(
        "COMPLETE stays when shots are missing again",
        _OPENING,
        "    if session.complete:\n        # COMPLETE",
        "    if False:\n        # COMPLETE",
    ),
    Planted(
        "a damaged frame is intact",
        _CHECK,
        '    if sha256_of(data) != frame.file_sha256:\n        return "was changed',
        '    if not data:\n        return "was changed',
    ),
    Planted(
        "verify does not name damaged frames",
        _VERIFY,
        "            damaged.append(frame.path.name)\n",
        "",
    ),
    Planted(
        "a hold that is shorter than the exposure",
        _SHOOTING,
        "    return min(math.ceil(needed_ms + bench.config.frame_timeout_s * 1000), longest_ms)",
        "    return min(math.ceil(lit_us / 1000 / 2), longest_ms)",
    ),
    Planted(
        "the frame is attributed to the next LED of the sequence",
        _SEQUENCE,
        "        shot = Shot(frame, led, BoardEcho(",
        "        shot = Shot(frame, leds[(index + 1) % len(leds)], BoardEcho(",
    ),
    Planted(
        "the exposure time is set once",
        _RIG,
        "        if self._times is None or self._settings != (exposure_us, gain_db):",
        "        if self._times is None:",
    ),
    Planted(
        "the clock of a flash is fast",
        "rig/shooting/shot_times.py",
        "        return math.ceil(self.needed_us * (1 + CLOCK_SHARE) + self.margin_us)",
        "        return math.ceil(self.needed_us / 2)",
    ),
    Planted(
        "a line has the number of the one before",
        _JOURNAL,
        "        self._seq, self._previous = self._seq + 1, own\n        self._unsure = False",
        "        self._previous = own\n        self._unsure = False",
    ),
    Planted(
        "a line is chained to the one before the last",
        _JOURNAL,
        "        self._seq, self._previous = self._seq + 1, own\n        self._unsure = False",
        "        self._seq += 1\n        self._unsure = False",
    ),
    Planted(
        "lines are written from the start of the journal",
        _JOURNAL,
        "os.O_WRONLY | os.O_APPEND)",
        "os.O_WRONLY)",
    ),
    Planted(
        "fsync of the journal before the write",
        _STORAGE,
        "        write_whole(descriptor, data)\n        filesystem.fsync(descriptor)",
        "        filesystem.fsync(descriptor)\n        write_whole(descriptor, data)",
    ),
    Planted(
        "a shared lock",
        _STORAGE,
        "            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)\n"
        "        except BlockingIOError:\n            files",
        "            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)\n"
        "        except BlockingIOError:\n            files",
    ),
    Planted(
        "a torn line is damage",
        _LINES,
        "    return journal(torn=tail)",
        '    return journal(damage=f"line {number} is damaged: it is torn")',
    ),
    Planted(
        "a torn line counts",
        _LINES,
        "    if _seal_of(line, previous) is not None:",
        "    if tail:",
    ),
    Planted(
        "the mark of another journal",
        _WRITER,
        "completion_mark(self._journal.read_back())",
        "completion_mark(self._journal.read_back()[:-1])",
    ),
    Planted(
        "rejected frames count when a session is read",
        _FRAMES,
        'for seq, frame in takes if frame.line.status == "ok"}',
        "for seq, frame in takes}",
    ),
    Planted(
        "files without a line stay where they are",
        _OPENING,
        "    aside = clear_frames(session)\n",
        "    aside: list[str] = []\n",
    ),
    Planted(
        "the shelf of files has one place for each name",
        _ASIDE,
        "    return next(path for path in paths if not os.path.lexists(path))",
        "    return next(paths)",
    ),
    Planted(
        "a frame that was set aside stays in place",
        _ASIDE,
        "        if there:\n            _move(frame.path, kept)\n    return tuple(lines)",
        "    return tuple(lines)",
    ),
    Planted(
        "earlier frames are not read back",
        _PROOFS,
        "        damage = frame_damage(frame, self._camera)",
        "        damage = None",
    ),
    Planted(
        "the hash of the samples misses the last bytes",
        _FILE,
        "            of_pixels.update(piece)",
        "            of_pixels.update(piece[:-2])",
    ),
    Planted(
        "the name of a failed write is given again",
        _FILE,
        "                if path.name not in self._taken and not path.exists():",
        "                if path.name not in self._taken:",
    ),
    Planted(
        "a recorded shot stays missing",
        _OPEN,
        "                self._missing.pop(line.key, None)",
        "                self._missing.get(line.key, None)",
    ),
    Planted(
        "verify does not see that shots are missing",
        _VERIFY,
        "        missing=tuple(shot.file for shot in session.missing),",
        "        missing=(),",
    ),
    Planted(
        "verify takes an incomplete session for a complete one",
        _VERIFY,
        "        complete=session.complete,",
        "        complete=bool(session.recorded),",
    ),
)
