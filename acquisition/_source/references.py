"""Dark and ambient frames in a plain folder of images, recognised by their names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

from rig import Notice, pluralize

Reference = Literal["ambient", "dark"]

# At the beginning of a name, or as its last word (``sample_raw_ambient``).
_NAME: Final = re.compile(r"(?:^|.*[-_. ](?=[a-z]+[-_. ]?\d*$))(dark|ambient)", re.IGNORECASE)


def split_references(
    images: Sequence[Path], listed: int = 0
) -> tuple[list[Path], dict[Path, Reference]]:
    """Return the images that are no dark or ambient frames, and those that are, with their roles.

    Names that begin with ``dark`` or ``ambient``, or whose last word does, are such frames. If more
    than half of the images have such names, they belong to an object, and none is.
    ``listed`` is the number of other images that a list of lights names.
    """
    found: dict[Path, Reference] = {}
    for path in images:
        match = _NAME.match(path.stem)
        if match is not None:
            found[path] = "dark" if match[1].casefold() == "dark" else "ambient"
    if listed + len(images) - len(found) < max(1, len(found)):
        return list(images), {}
    return [path for path in images if path not in found], found


def reference_notices(
    folder: Path, references: Mapping[Path, Reference], assumed: bool
) -> tuple[Notice, ...]:
    """Return the notice that names the roles of reference frames; none without any.

    ``assumed`` is whether one has the exposure time of the images because it states none.
    """
    if not references:
        return ()
    roles: tuple[Reference, ...] = ("dark", "ambient")
    counts = [(role, sum(other == role for other in references.values())) for role in roles]
    found = " and ".join(pluralize(count, f"{role} frame") for role, count in counts if count)
    text = f"{found}, by name ({next(iter(references)).name})"
    if assumed:
        text += ", with the exposure time of the images"
    return (Notice("reference-frames-found", text, str(folder), "info"),)
