"""The groups of properties and of transfers: all tables that the available data allow."""

from __future__ import annotations

from benchmarks.paper import figures as paper
from benchmarks.paper.comparison import Comparison, Picture
from benchmarks.paper.heights import height_profiles
from benchmarks.paper.local import local_transfers
from benchmarks.paper.properties import chain, exchange, of_textures
from benchmarks.paper.sources import Sources
from benchmarks.paper.transfer import by_resolution, onto_diligent
from rig import Progress

_QUICK_POINTS = 160_000

_PROPERTIES = (
    "# Properties of the detail\n\n"
    "Every table is followed by the one that the paper prints. Its surfaces are not available: "
    "read its figures as context."
)
_TRANSFERS = (
    "# Transfers\n\n"
    "Every table is followed by the one that the paper prints, on other surfaces and another "
    "computer. The rows 'from the same surfaces' and 'as surfaces' compare the methods under equal "
    "conditions."
)


def run_properties(*, quick: bool, advance: Progress) -> Comparison:
    """Compute the tables of the properties of the detail; `quick` leaves nothing out.

    Parameters
    ----------
    quick
        Has no effect.
    advance
        Called before each step: what it does, and how much of this table is done.
    """
    del quick
    sources, comparison = Sources.found(), Comparison(_PROPERTIES)
    textures = sources.textures()
    alike, apart, again, panels = of_textures(textures, advance)
    comparison.tables += [alike, apart, again]
    comparison.pictures["separability"] = Picture(
        "Details, and the shape left in them (order 8)", panels, 4
    )
    if sources.data is not None:
        comparison.tables.append(chain(sources, advance))
    exchanged = exchange(textures, advance)
    comparison.add("cross_exchange", "Details exchanged (order 8)", 4, *exchanged)
    if sources.data is None:
        comparison.without_data("owl, plant and chain are left out; all data are simulated")
    comparison.files = sorted(sources.files)
    return comparison


def run_transfers(*, quick: bool, runs: int | None, advance: Progress) -> Comparison:
    """Compute the tables of transfers.

    Parameters
    ----------
    quick
        Skip the largest numbers of points.
    runs
        Number of runs per measurement; default: 10 as in the paper, 1 with `quick`.
    advance
        Called before each step: what it does, and how much of this table is done.
    """
    runs = runs or (1 if quick else 10)
    sources, comparison = Sources.found(), Comparison(_TRANSFERS)
    points = [count for count in paper.POINTS if not quick or count <= _QUICK_POINTS]
    tables, panels = by_resolution(sources, points, runs, advance)
    comparison.tables += tables
    comparison.pictures["resolution"] = Picture("One transfer by four methods", panels, 4)
    table, comparison.profiles, panels = height_profiles(sources, sources.textures(), advance)
    title = "Heights, sorted by the target's (order 8)"
    comparison.add("height_profile", title, 2, table, panels)
    if sources.data is None:
        comparison.without_data(
            "bunny, DiLiGenT targets and local transfers are left out; all data are simulated"
        )
    else:
        tables, panels = onto_diligent(sources, runs, advance)
        comparison.tables += tables
        comparison.pictures["diligent"] = Picture(
            "Cracks on the DiLiGenT targets (order 1)", panels, 5
        )
        local = local_transfers(sources, advance)
        comparison.add("local", "Faces transferred to other surfaces", 3, *local)
    if quick:
        comparison.shortened(
            f"more than {_QUICK_POINTS} points are left out, and with them the headline ratio"
        )
    comparison.files = sorted(sources.files)
    return comparison
