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
from sgp._map_doubts import read_map, with_doubts
from sgp._memory_limit import Limit, identity, stored
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
    limit: Limit, normals: Path, how: Enlarging, *, green: Literal["up", "down"], max_pixels: int
) -> Iterator[Enlarged]:
    """Provide a normal map that is enlarged with a limited memory.

    Parameters
    ----------
    limit
        Memory to use, and where maps that do not fit are.
    normals, how, green, max_pixels
        The map, how it is enlarged, and how it is read.

    Raises
    ------
    UsageError
        If the memory is too small, or there are unfinished maps of another command.
    """
    found = processing.find_normals(normals, max_pixels=max_pixels)
    most = max(max_pixels, rig.MAX_PIXELS)
    need = superres_need(found.size, how.scale, how.network)
    if not limit.must_be_stored(need):
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
            limit.path,
            how.scale,
            identity=depends_on,
            replace=limit.force,
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
        low = normals, on_disk.low, on_disk.low_mask, green
        yield Enlarged.on_disk(on_disk, with_doubts(on_disk.warnings, *low))


def superres_need(
    size: tuple[int, int], scale: int, network: processing.SuperResolutionModel | None
) -> processing.Need:
    """Return the memory that the enlargement of a map of (height, width) needs."""
    # Without a network, what it would need is reserved, too.
    halo = {} if network is None else {"halo_px": network.halo_px}
    return processing.Need(
        processing.memory_of_super_resolution(size, scale, **halo),
        processing.least_memory_of_super_resolution(size, scale, **halo),
        f"a normal map of {size[1]} x {size[0]} pixels at scale {scale}",
    )


def network_files(network: processing.SuperResolutionModel | None) -> list[Path]:
    """Return a network and its description."""
    return [] if network is None else [network.path, network.path.with_suffix(".json")]
