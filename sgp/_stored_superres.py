"""Enlarged normal maps in memory, or in files if they need more memory than there is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import processing
import rig
from sgp._console import Stages
from sgp._map_doubts import axes_doubts, read_map
from sgp._memory_limit import Need, identity, must_be_stored, stored
from sgp._write_superres import Enlarged


@dataclass(frozen=True, kw_only=True)
class Enlarging:
    """How a map is enlarged, as for `processing.super_resolve`."""

    scale: Literal[2, 4]
    method: processing.SuperResolutionMethod | None
    network: processing.SuperResolutionModel | None
    self_ensemble: bool | None
    sampling: processing.PixelSampling


@contextmanager
def enlarged_within(
    memory: int | None,
    normals: Path,
    how: Enlarging,
    *,
    green: Literal["up", "down"],
    max_pixels: int,
    out: Path,
    force: bool,
) -> Iterator[Enlarged]:
    """Provide a normal map that is enlarged with a limited memory.

    Parameters
    ----------
    memory
        Bytes to use; None for half of what is free.
    normals, how, green, max_pixels
        The map, how it is enlarged, and how it is read.
    out
        Future result. Maps that do not fit into memory are in a hidden folder there until the block
        ends without an error; another call continues them.
    force
        Whether unfinished maps of other inputs or options are removed.

    Raises
    ------
    UsageError
        If the memory is too small, or there are unfinished maps of another command.
    """
    found = processing.find_normals(normals, max_pixels=max_pixels)
    path, most = out / "superres", max(max_pixels, rig.MAX_PIXELS)
    need = superres_need(found.size, how.scale, how.network)
    if not must_be_stored(memory, need, path):
        read = read_map(normals, green=green, max_pixels=max_pixels)
        with Stages() as progress:
            made = processing.super_resolve(
                read.normal_map,
                how.scale,
                method=how.method,
                model=how.network,
                self_ensemble=how.self_ensemble,
                sampling=how.sampling,
                max_pixels=most,
                on_progress=progress,
            )
        yield Enlarged.in_memory(made, read)
        return
    files = [*found.files, *network_files(how.network)]
    options = {
        "scale": how.scale,
        "method": how.method,
        "self_ensemble": how.self_ensemble,
        "sampling": how.sampling,
        "green": green,
    }
    depends_on = identity(options, files)
    with stored(
        lambda progress: processing.super_resolve_on_disk(
            normals,
            path,
            how.scale,
            identity=depends_on,
            replace=force,
            method=how.method,
            model=how.network,
            self_ensemble=how.self_ensemble,
            sampling=how.sampling,
            green=green,
            max_pixels=max_pixels,
            most_enlarged=most,
            on_progress=progress,
        )
    ) as on_disk:
        yield Enlarged.on_disk(on_disk, axes_doubts(normals, on_disk.low, on_disk.low_mask, green))


def superres_need(
    size: tuple[int, int], scale: int, network: processing.SuperResolutionModel | None
) -> Need:
    """Return the memory that the enlargement of a map of (height, width) needs."""
    # Without a network, what it would need is reserved, too.
    halo = {} if network is None else {"halo_px": network.halo_px}
    return Need(
        processing.memory_of_super_resolution(size, scale, **halo),
        processing.least_memory_of_super_resolution(size, scale, **halo),
        f"a normal map of {size[1]} x {size[0]} pixels at scale {scale}",
    )


def network_files(network: processing.SuperResolutionModel | None) -> list[Path]:
    """Return a network and its description."""
    return [] if network is None else [network.path, network.path.with_suffix(".json")]
