"""All tables of the comparison, in the order of the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from sgp._overview import Panel
from sgp._paper import figures as paper
from sgp._paper.local import local_transfers
from sgp._paper.properties import chain, exchange, of_textures
from sgp._paper.sources import Sources
from sgp._paper.tables import Table
from sgp._paper.transfer import by_resolution, onto_diligent

_QUICK_POINTS = 50_000

_PREFACE = (
    "# The paper's tables\n\n"
    "Surface Geometry Processing: An Efficient Normal-based Detail Representation. Every table "
    "stands beside the one the paper prints. The surfaces are not the paper's, which are not to be "
    "had, nor is the computer: read the paper's figures as context, the peers' as comparison."
)


@dataclass
class Comparison:
    """What was made: tables, pictures by name, and what had to be left out."""

    preface: str = _PREFACE
    tables: list[Table] = field(default_factory=list)
    pictures: dict[str, tuple[str, list[Panel]]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)


def run_all(*, quick: bool, runs: int, advance: Callable[[str], None]) -> Comparison:
    """Make every table that can be made from the data at hand.

    Parameters
    ----------
    quick
        Leaves out the largest numbers of points.
    runs
        Runs per measurement.
    advance
        Is told what is begun.
    """
    sources = Sources.found()
    made = Comparison()
    textures = sources.textures()
    alike, apart, again, panels = of_textures(textures, advance)
    made.tables += [alike, apart, again]
    made.pictures["separability"] = ("Details, and the shape left in them (order 8)", panels)
    if sources.data is not None:
        made.tables.append(chain(sources, advance))
    exchanged, panels = exchange(textures, advance)
    made.tables.append(exchanged)
    made.pictures["cross_exchange"] = ("Details exchanged (order 8)", panels)
    points = [count for count in paper.POINTS if not quick or count <= _QUICK_POINTS]
    table, headline, panels = by_resolution(sources, points, runs, advance)
    made.tables += [table, headline]
    made.pictures["resolution"] = ("One transfer by four methods", panels)
    if sources.data is None:
        made.left_out.append(
            "SGP_DATA is not set: owl, plant, bunny, DiLiGenT targets, chain and local transfers "
            "are missing; what is here is simulated"
        )
    else:
        table, variants, panels = onto_diligent(sources, runs, advance)
        made.tables += [table, variants]
        made.pictures["diligent"] = ("Cracks on the DiLiGenT targets (order 1)", panels)
        table, panels = local_transfers(sources, advance)
        made.tables.append(table)
        made.pictures["local"] = ("Faces set into other surfaces", panels)
    if quick:
        made.left_out.append(
            f"--quick: points above {_QUICK_POINTS}, and with them the headline ratio"
        )
    return made
