"""What another program may plant under a name that is written next."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

Plant = Callable[[Path, Path], object]
PLANTED: dict[str, Plant] = {
    "link": lambda name, victim: name.symlink_to(victim),
    "link_to_nothing": lambda name, victim: name.symlink_to(victim.with_name("nothing")),
    "hard_link": lambda name, victim: name.hardlink_to(victim),
    "pipe": lambda name, _: os.mkfifo(name),
    "rest": lambda name, _: name.write_bytes(b"half of a lon"),
    "unreadable_rest": lambda name, _: (name.write_bytes(b"half"), name.chmod(0)),
    "device": lambda name, _: name.symlink_to("/dev/full"),
}


def unharmed(victim: Path) -> bool:
    return [(p.name, p.read_bytes()) for p in victim.parent.iterdir()] == [("victim", b"mine")]
