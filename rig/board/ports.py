"""Search for the LED board on all serial ports."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass

from rig._errors import BoardError
from rig.board.board import Board
from rig.board.values import BoardIdentity
from rig.host import clock, lines, threads
from rig.messages.representation import differences

# A board that resets when its port opens may stay in its boot loader for two seconds.
DISCOVERY_TIMEOUT_S = 3.0
# Additional time for opening and closing a port.
_GRACE_S = 2.0


@dataclass(frozen=True)
class FoundPort:
    """A serial port and the LED board on it, if there is one.

    Parameters
    ----------
    port
        Device path.
    identity
        Identity of the LED board that answered, None if no board answered.
    problem
        What is wrong with the port if no board answered, otherwise empty.
    """

    port: str
    identity: BoardIdentity | None
    problem: str


def find_boards(
    ports: Iterable[str] | None = None, *, timeout_s: float = DISCOVERY_TIMEOUT_S
) -> tuple[FoundPort, ...]:
    """Query all ports at the same time for an LED board.

    A device of another kind receives an empty line and the protocol's ``ID`` a few times.

    Parameters
    ----------
    ports
        Device paths; None for every serial port of this computer.
    timeout_s
        How long a board may take to answer.

    Returns
    -------
    tuple of FoundPort
        Ports in the order of ``ports``. A port that is silent, sends other data, is busy or has
        disappeared has a problem; nothing is raised for it, and no port is waited for much longer
        than ``timeout_s``.

    Examples
    --------
    >>> from rig.board import find_boards
    >>> from simulator.led_board import VirtualBoard
    >>> with VirtualBoard(leds=4) as board:
    ...     found = find_boards([board.port])
    >>> found[0].identity.leds
    4
    """
    if ports is None:
        ports = sorted(lines.ports())
    found: dict[str, FoundPort] = {}

    def ask(port: str) -> None:
        try:
            board = Board(port, handshake_timeout_s=timeout_s)
            found[port] = FoundPort(port, board.identity, "")
            board.close()
        except BoardError as error:
            found.setdefault(port, FoundPort(port, None, str(error)))

    # Daemon threads: a port whose driver never returns must not keep the program from ending.
    asking = {
        port: threads.Thread(target=ask, args=(port,), daemon=True) for port in dict.fromkeys(ports)
    }
    for thread in asking.values():
        thread.start()
    ends_s = clock.monotonic() + timeout_s + _GRACE_S
    for thread in asking.values():
        thread.join(max(0.0, ends_s - clock.monotonic()))
    stuck = "LED board on {}: the port takes longer than {:g} s to open or close; check its driver"
    return tuple(
        found.get(port) or FoundPort(port, None, stuck.format(port, timeout_s + _GRACE_S))
        for port in asking
    )


def find_board(
    ports: Iterable[str] | None = None,
    *,
    name: str | None = None,
    timeout_s: float = DISCOVERY_TIMEOUT_S,
) -> str:
    """Return the port of the one LED board.

    Parameters
    ----------
    ports, timeout_s
        See `find_boards`.
    name
        Name that the board's firmware must have; None for any.

    Raises
    ------
    BoardError
        If there is no board (the message lists the finding at each port) or more than one (the
        message lists their ports).

    Examples
    --------
    >>> from rig.board import find_board
    >>> from simulator.led_board import VirtualBoard
    >>> with VirtualBoard(leds=4) as board:
    ...     found = find_board([board.port])
    >>> found == board.port
    True
    """
    found = find_boards(ports, timeout_s=timeout_s)
    boards = {port.port: port.identity for port in found if port.identity is not None}
    wanted = [port for port, board in boards.items() if name in (None, board.name)]
    if len(wanted) == 1:
        return wanted[0]
    called = "" if name is None else f" named {name}"
    if wanted:
        raise BoardError(
            f"{len(wanted)} LED boards{called} found, on {', '.join(wanted)}: give the port to "
            "use, or unplug the others"
        )
    others = [f"{board.name} is on {port}" for port, board in boards.items()]
    problems = [port.problem for port in found if port.problem]
    if not problems:  # each problem ends with its own advice
        problems = ["check cable and power"]
        others = others or ["this computer has no serial port"]
    raise BoardError(f"no LED board{called} found: {'; '.join(others + problems)}")


class BoardPlace:
    """Where a board is plugged in, to open it again after it was gone.

    Another board that was plugged in when this one was opened is never taken for it, even if the
    two have exchanged the names of their ports.

    Parameters
    ----------
    board
        Open board.
    """

    def __init__(self, board: Board) -> None:
        self._port, self._identity = board.port, board.identity
        devices = lines.ports()
        self._others = set(devices.values()) - {_device_on(board.port, devices)}

    def open(self) -> Board:
        """Open the board on its port, or else on a port of a device that is new.

        Raises
        ------
        BoardError
            If it does not answer on any of them.
        """
        devices = lines.ports()
        own = os.path.realpath(self._port)
        ports = [self._port, *(port for port in sorted(devices) if os.path.realpath(port) != own)]
        problems = []
        for port in ports:
            if _device_on(port, devices) in self._others:
                continue
            try:
                board = Board(port)
            except BoardError as error:
                problems.append(str(error))
                continue
            changes = differences(asdict(self._identity), asdict(board.identity))
            if not changes:
                return board
            problems.append(f"LED board on {port} is another one: {changes}")
            board.close()
        raise BoardError("; ".join(problems) or f"another device is on {self._port}")


def _device_on(port: str, devices: Mapping[str, str]) -> str | None:
    return devices.get(port, devices.get(os.path.realpath(port)))
