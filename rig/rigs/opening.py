"""Opening of rigs by name or by rig file."""

from __future__ import annotations

from collections.abc import Callable

from rig._errors import RigConfigError
from rig.config.drivers import find_driver, find_rig_file, rig_names
from rig.config.rig_file import RigConfig, read_rig_config
from rig.rigs.bench import open_bench_board
from rig.rigs.board_only import OpenBoard
from rig.rigs.rig import Rig

BENCH = "bench"


def open_rig(name_or_path: str) -> Rig:
    r"""Open a rig.

    Parameters
    ----------
    name_or_path
        A name of the entry-point group ``sgp.rigs``, or the path of a rig file; a text with a
        folder or the suffix ``.toml`` is interpreted as a path.

    Raises
    ------
    RigNotFoundError
        If there is no such name or file.
    RigConfigError
        If the file is invalid.
    RigError
        If the rig does not open.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import open_rig
    >>> options = '[options]\nwidth = 64\nheight = 52\ncamera = "inside"\n'
    >>> desk = 'name = "desk"\ndriver = "simulated"\nleds = 4\n'
    >>> _ = Path("desk.toml").write_text(desk + options)
    >>> with open_rig("desk.toml") as rig:  # or the name of an installed rig: open_rig("simulated")
    ...     shot = rig.shoot(2, exposure_us=10_000.0)
    >>> shot.led
    2
    """
    config = find_rig_config(name_or_path)
    return _driver(config)(config)


def open_board(name_or_path: str) -> OpenBoard:
    r"""Open a rig for its LEDs only: with the driver ``bench`` only the board, without its camera.

    Parameters
    ----------
    name_or_path
        See `open_rig`; the name ``bench`` stands for the only board on any port.

    Raises
    ------
    RigError
        As `open_rig`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig.rigs import open_board
    >>> options = "[options]\nwidth = 64\nheight = 52\n"
    >>> desk = 'name = "desk"\ndriver = "simulated"\nleds = 4\n'
    >>> _ = Path("desk.toml").write_text(desk + options)
    >>> with open_board("desk.toml") as opened:
    ...     opened.board.identity.leds
    4
    """
    config = find_rig_config(name_or_path)
    return open_bench_board(config) if config.driver == BENCH else _driver(config)(config)


def find_rig_config(name_or_path: str) -> RigConfig:
    r"""Return the configuration of a rig without opening it.

    Parameters
    ----------
    name_or_path
        See `open_rig`.

    Raises
    ------
    RigNotFoundError
        If there is no such name or file.
    RigConfigError
        If the file is invalid.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import find_rig_config
    >>> _ = Path("desk.toml").write_text('name = "desk"\ndriver = "simulated"\nleds = 4\n')
    >>> find_rig_config("desk.toml")
    RigConfig(desk, driver simulated, 4 LEDs)
    """
    path = find_rig_file(name_or_path)
    if path is None:
        return RigConfig(name=name_or_path, driver=name_or_path)
    return read_rig_config(path)


def _driver(config: RigConfig) -> Callable[[RigConfig], Rig]:
    found = find_driver(config.driver)
    if found is None:
        raise RigConfigError(
            f"rig {config.name}: no driver is called {config.driver!r} "
            f"(known: {', '.join(rig_names()) or 'none'})"
        )
    try:
        driver: Callable[[RigConfig], Rig] = found.load()
    except (ImportError, AttributeError) as error:
        raise RigConfigError(
            f"rig {config.name}: the driver {config.driver!r} cannot be loaded ({error})"
        ) from error
    return driver
