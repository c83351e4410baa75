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
        "a repetition is a new command",
        _LINE,
        "            self._send(command, darkened)\n            reply = self._await(command, REPLY",
        "            command = self._next(verb, args)\n            self._send(command, darkened)\n"
        "            reply = self._await(command, REPLY",
    ),
    Planted(
        "a reply to any command of the verb is accepted",
        _LINE,
        "return reply.seq == command.seq and reply.verb == command.verb",
        "return reply.verb == command.verb",
    ),
    Planted(
        "commands are sent after an emergency OFF",
        _LINE,
        "        self._darkened += 1\n",
        "",
    ),
    Planted(
        "an emergency OFF is no command",
        _LINE,
        'encode_command(Command(apart, "OFF"))',
        'encode_command(Command(apart, "ID"))',
    ),
    Planted(
        "no checksum",
        "rig/board/protocol.py",
        'if int(match["crc"], 16) != crc16(match["body"]):',
        'if int(match["crc"], 16) < 0:',
    ),
    Planted(
        "the echo of ON is not compared",
        _BOARD,
        'outcome = self._echoed("ON", str(led), str(hold_ms))',
        'outcome = self._line.ask("ON", str(led), str(hold_ms)).done()',
    ),
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
        "a dark frame without OFF",
        _SHOOTING,
        "    if led is None:\n        board.off()\n    else:",
        "    if led is None:\n        pass\n    else:",
    ),
    Planted(
        "the light of a flash is not checked",
        _SHOOTING,
        "    if report.led != led:\n",
        "    if report.led != led and led is None:\n",
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
        "the first frame of a sequence is not held back",
        _SEQUENCE,
        "        if index == 0:\n            held_back = shot\n"
        "        else:\n            yield shot",
        "        yield shot",
    ),
    # The end of a program.
    Planted(
        "no OFF after an error",
        _RUN,
        "            confirmed = _turn_leds_off(rig, error)",
        "            confirmed = True",
    ),
    Planted(
        "no OFF at a signal",
        _OFF,
        "    for darken in tuple(watched.values()):\n        darken()\n",
        "",
    ),
    Planted(
        "no OFF when the rig is closed",
        _RIG,
        "        closing = board.off, camera.disarm, camera.close, board.close, on_close",
        "        closing = camera.disarm, camera.close, board.close, on_close",
    ),
    Planted(
        "no OFF after a failed shot",
        _RIG,
        "            try:\n                self.board.off()\n"
        "            except RigError as failure:\n"
        '                note(error, "LEDs not confirmed off", failure)\n            raise',
        "            raise",
    ),
    # The loop of a recording.
    Planted(
        "the rig's word is taken for the light",
        _LOOP,
        "        conflict = wrong_light(planned, lit)\n",
        "        conflict = None\n",
    ),
    Planted(
        "a light that contradicts the plan is accepted",
        _LIGHT,
        "        if (led is None) if any_led else (led != planned.led):",
        "        if (led is None) if any_led else False:",
    ),
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
        "        self._todo.put_back(group)\n",
        "",
    ),
    Planted(
        "shots are put back in the wrong order",
        _ORDER,
        "        self._shots.extendleft(reversed(shots))",
        "        self._shots.extendleft(shots)",
    ),
    Planted(
        "the session is completed although a write failed",
        _QUEUE,
        "            if not results and self._error is not None:\n"
        "                raise self._error",
        "",
    ),
    # Files.
    Planted("no fsync of a file", _STORAGE, "            files.fsync(part.descriptor)\n", ""),
    Planted(
        "no fsync of a folder after a rename",
        _STORAGE,
        "            sync_folder(path.parent)\n",
        "",
    ),
    Planted(
        "rename before fsync",
        _STORAGE,
        "            files.fsync(part.descriptor)\n            check_publishing()",
        "            check_publishing()",
    ),
    Planted(
        "a short write is complete",
        _STORAGE,
        "        view = view[files.write(descriptor, view) :]",
        "        files.write(descriptor, view)\n        view = view[len(view) :]",
    ),
    Planted(
        "no fsync of the journal",
        _STORAGE,
        "        write_whole(descriptor, data)\n        files.fsync(descriptor)",
        "        write_whole(descriptor, data)",
    ),
    Planted(
        "no fsync of the folder of a new folder",
        _STORAGE,
        "        for created in new:\n            sync_folder(created.parent)",
        "        pass",
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
        "            files.rename(early, path)\n",
    ),
    Planted(
        "two threads may write a line at once",
        _WRITER,
        "        with self._order:\n            self._use.check_open()",
        "        if True:\n            self._use.check_open()",
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
        "completion without a look at missing shots",
        _WRITER,
        "        if missing:\n            raise DataError(",
        "        if missing and not self.shots.demanded:\n            raise DataError(",
    ),
    Planted(
        "completion without a look at earlier frames",
        _WRITER,
        "            self.proofs.check_all()\n            self.proofs.check_undamaged()\n",
        "",
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
        "        files.unlink(path)\n    with disk(frames",
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
)
