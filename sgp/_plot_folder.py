"""The folder of matplotlib's own files, where those of the user cannot be written."""

from __future__ import annotations

import os
from pathlib import Path

import rig

_VARIABLE = "MPLCONFIGDIR"


def choose_plot_folder() -> None:
    """Choose a private folder if matplotlib, before it is loaded, would find none of the user."""
    if os.environ.get(_VARIABLE):
        return
    try:
        for variable, usual in (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache")):
            place = Path(os.environ.get(variable) or Path.home() / usual) / "matplotlib"
            place.mkdir(parents=True, exist_ok=True)
            if not os.access(place, os.W_OK):
                raise PermissionError
    except (OSError, RuntimeError):  # RuntimeError: there is no home folder
        folder = rig.private_folder()
        if folder is not None:
            os.environ[_VARIABLE] = str(folder / "matplotlib")
