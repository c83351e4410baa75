"""Lines: which are read, ignored or counted, and that damaged lines are never carried out."""

from __future__ import annotations

from rig.host import clock
from tests.rig.conformance._check import check
from tests.rig.conformance.board import BoardUnderTest, line, signed

ON = b">00A1 ON 7 1000"
# Damaged lines by kind, without line ends: each is counted and not answered.
DAMAGED = {
    "no checksum": ON,
    "wrong checksum": signed(ON)[:-1] + b"!",
    "checksum of another line": ON + signed(b">00A2 ON 7 1000")[-5:],
    "small letters in the checksum": b">00A2 OFF*6e31",
    "short checksum": signed(ON)[:-1],
    "long checksum": signed(ON) + b"0",
    "a reply": signed(b"<00A1 OK ON 7 1000"),
    "no mark": signed(b"00A1 ON 7 1000"),
    "short number": signed(b">0A1 ON 7 1000"),
    "long number": signed(b">000A1 ON 7 1000"),
    "small letters in the number": signed(b">00a1 ON 7 1000"),
    "two spaces": signed(b">00A1  ON 7 1000"),
    "space at the end": signed(b">00A1 ON 7 1000 "),
    "no verb": signed(b">00A1"),
    "space and no verb": signed(b">00A1 "),
    "tab": signed(b">00A1\tON 7 1000"),
    "not ASCII": signed(b">00A1 ON 7 1000\xe4"),
    "noise before": b"x" + signed(ON),
    "noise after": signed(ON) + b" ",
    "two commands in one": signed(ON) + signed(ON),
    "mark alone": b">",
    "star alone": b"*",
}


@check("damaged lines are counted, not answered and not carried out")
def _(board: BoardUnderTest) -> None:
    before = board.status().faults
    for number, (what, text) in enumerate(DAMAGED.items(), 1):
        board.write(text + b"\n")
        counted = board.status().faults - before
        assert counted == number, f"{what}: counted {counted}, expected {number}"
    board.no_edge()


@check("no line with a single flipped bit is carried out")
def _(board: BoardUnderTest) -> None:
    whole = line(0x00A1, "ON 7 1000")
    before, damaged = board.status().faults, 0
    for bit in range(8 * (len(whole) - 1)):
        text = bytearray(whole)
        text[bit // 8] ^= 1 << bit % 8
        board.write(bytes(text))
        # A flipped bit can create a line end, and then a piece may be empty.
        damaged += sum(piece not in (b"", b"\r") for piece in bytes(text).split(b"\n"))
        if bit % 8 == 7:
            assert board.status().faults - before == damaged, bytes(text)
    board.no_edge()


@check("empty lines are ignored")
def _(board: BoardUnderTest) -> None:
    before = board.status().faults
    board.write(b"\n\r\n\n\r\n")
    board.silent()
    assert board.status().faults == before


@check("lines that are too long are ignored and have no effect on others")
def _(board: BoardUnderTest) -> None:
    before = board.status().faults
    for length in (65, 66, 80, 256, 257, 1000):
        body = b">00A1 ON 7 1000 "
        board.write(signed(body + b"x" * (length - len(body) - 5)) + b"\n")
        board.write(signed(ON) + b"x" * length + b"\n")
        board.silent(0.05)
        assert board.status().faults == before, length
    board.no_edge()


@check("the longest command is answered completely")
def _(board: BoardUnderTest) -> None:
    for words in ("X" * 53, " ".join(["9" * 8] * 5) + " 77777777"):
        seq = board.next_seq()
        assert len(line(seq, words)) == 65
        assert board.ask(words, seq) == f"E1 {words}"


@check("a carriage return before the line end is ignored")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    board.write(line(seq, "STATUS")[:-1] + b"\r\n")
    assert board.answer(seq).startswith("OK STATUS")


@check("a line with more than one carriage return before its end is damaged")
def _(board: BoardUnderTest) -> None:
    before = board.status().faults
    for number, end in enumerate((b"\r\r\n", b"\r\r\r\n"), 1):
        board.write(line(board.next_seq(), "ON 7 1000")[:-1] + end)
        board.silent(0.05)
        assert board.status().faults == before + number, end
    board.no_edge()


@check("a carriage return after the line end belongs to the next line")
def _(board: BoardUnderTest) -> None:
    before = board.status().faults
    seq = board.next_seq()
    board.write(line(seq, "LEVEL 3 4095") + b"\r" + line(board.next_seq(), "ON 7 1000"))
    assert board.answer(seq) == "OK LEVEL 3 4095"
    assert board.status().faults == before + 1
    board.no_edge()


@check("half a line from before a reset is discarded")
def _(board: BoardUnderTest) -> None:
    whole = line(board.next_seq(), "ON 7 1000")
    board.write(whole[:9])
    # Wait until it has arrived before the reset, otherwise it would be lost.
    clock.sleep(0.1)
    board.order("reset")
    board.write(whole[9:])
    board.greet()
    board.drain()
    assert board.ok("OFF") == "-"


@check("a line may arrive byte by byte")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    for byte in line(seq, "LEVEL 3 4095"):
        board.write(bytes((byte,)))
        clock.sleep(0.002)
    assert board.answer(seq) == "OK LEVEL 3 4095"


@check("half a line does not damage the next line")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    board.write(b">00A1 ON 8 50\n" + line(seq, "STATUS"))
    assert board.answer(seq).startswith("OK STATUS")
    board.no_edge(0.05)


@check("commands in one piece are answered in order")
def _(board: BoardUnderTest) -> None:
    numbers = [board.next_seq() for _ in range(8)]
    board.write(b"".join(line(seq, "ID" if seq % 2 else "STATUS") for seq in numbers))
    for seq in numbers:
        assert board.answer(seq).startswith("OK ID" if seq % 2 else "OK STATUS")


@check("the full range of sequence numbers is answered")
def _(board: BoardUnderTest) -> None:
    for seq in (0xFFFE, 0xFFFF, 0x0000, 0x0001, 0xABCD, 0x0A0A):
        assert board.ask("LEVEL 3 4095", seq) == "OK LEVEL 3 4095"
