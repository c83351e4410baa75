"""``sgp bench``: recompute the paper's tables, compare synthesised sheets, and super-resolution."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import acquisition
from sgp._console import note
from sgp._metrics import BenchMetrics, SheetBenchMetrics, SuperresBenchMetrics
from sgp._options import Count, OptionalInput, Seed
from sgp._output import claim_folder, writes_folder
from sgp._result import Result, dumps

if TYPE_CHECKING:
    from sgp._paper.comparison import Comparison


@writes_folder("bench.json")
def paper(
    *,
    out: Path,
    quick: bool = False,
    runs: Count | None = None,
    force: bool = False,
) -> Result:
    """Recompute the paper's tables from available data, next to the published figures.

    Normal maps are read from the folder in SGP_DATA or simulated. Two mesh-based methods,
    displacement (DSPL) and Laplacian editing (LAPL), are measured in the same run.

    For example:

        sgp bench paper --out tables --quick

    Parameters
    ----------
    out
        Folder for tables.md, tables.json, pictures of some tables, the height profiles as .csv,
        and bench.json.
    quick
        Use at most 50 thousand points and one run per measurement: about two minutes.
    runs
        Number of runs per measurement, which are averaged; default: 10 as in the paper, 1 with
        --quick.
    force
        Write into an output folder that already contains files.
    """
    from sgp._paper.run import run_all

    count = runs or (1 if quick else 10)
    comparison = run_all(quick=quick, runs=count, advance=_Steps())
    result = _written(comparison, out)
    metrics: BenchMetrics = {"tables": len(comparison.tables), "runs": count, "quick": quick}
    result.metrics = metrics
    return result


@writes_folder("bench.json")
def synthesis(*, out: Path, quick: bool = False, seed: Seed = 7, force: bool = False) -> Result:
    """Compare synthesised sheets with their exemplars, and with repeated and mirrored exemplars.

    The exemplars are simulated materials, drawn structures, and the reliefs and normal maps in the
    folder in SGP_DATA. Time and memory are measured for as many pixels as the paper's target has.

    For example:

        sgp bench synthesis --out tables --quick

    Parameters
    ----------
    out
        Folder for tables.md, tables.json, pictures of the sheets, the height profiles as .csv, and
        bench.json.
    quick
        Make sheets of 1024 x 1024 instead of 2048 x 2048 pixels, and leave out complete maps as
        exemplars: about two minutes instead of five.
    seed
        Seed of the simulated materials.
    force
        Write into an output folder that already contains files.
    """
    from sgp._paper.sheets import run_sheets

    comparison = run_sheets(quick=quick, seed=seed, advance=_Steps())
    result = _written(comparison, out)
    metrics: SheetBenchMetrics = {"tables": len(comparison.tables), "quick": quick}
    result.metrics = metrics
    return result


@writes_folder("bench.json")
def superres(
    *,
    out: Path,
    quick: bool = False,
    models: OptionalInput = None,
    seed: Seed = 7,
    force: bool = False,
) -> Result:
    """Compare super-resolution of normals and of details with bicubic interpolation.

    The maps are those in the folder in SGP_DATA, simulated materials, drawings and smooth shapes.
    The tables have the errors of normals and heights by class of surface, and how well the
    predicted deviations agree with the errors. With --models, networks on details are compared
    with networks on plain normals.

    For example:

        sgp bench superres --out tables --quick
        sgp bench superres --models trained --out tables

    Parameters
    ----------
    out
        Folder for tables.md, tables.json, pictures of a head and of parts of maps, and bench.json.
    quick
        Use the middle 256 x 256 pixels of the maps, and only scale 4.
    models
        Folder with networks (.onnx) and their descriptions, of both domains and several seeds of
        the training, for comparing the domains. They should be trained alike.
    seed
        Seed of the simulated materials.
    force
        Write into an output folder that already contains files.
    """
    from sgp._paper.superres import run_superres

    comparison = run_superres(quick=quick, seed=seed, models=models, advance=_Steps())
    result = _written(comparison, out)
    metrics: SuperresBenchMetrics = {"tables": len(comparison.tables), "quick": quick}
    result.metrics = metrics
    return result


def _written(comparison: Comparison, out: Path) -> Result:
    """Write tables, pictures and profiles into a folder."""
    from dataclasses import asdict

    from sgp._overview import write_overview
    from sgp._paper.tables import markdown
    from sgp._write_profile import write_profile_data

    claim_folder(out, "bench.json")
    result = Result(warnings=list(comparison.left_out), inputs=comparison.files)
    result.outputs = {"tables": out / "tables.md", "tables_json": out / "tables.json"}
    for name, picture in comparison.pictures.items():
        result.outputs[name] = out / f"{name}.png"
        write_overview(result.outputs[name], *picture)
    for name, profile in comparison.profiles.items():
        result.outputs[f"{name}_data"] = out / f"{name}.csv"
        write_profile_data(result.outputs[f"{name}_data"], profile)
    left_out = [f"Note: {line}." for line in comparison.left_out]
    text = "\n\n".join([comparison.preface, *left_out, *map(markdown, comparison.tables)])
    acquisition.write_durably(result.outputs["tables"], f"{text}\n".encode())
    tables = {table.key: asdict(table) for table in comparison.tables}
    acquisition.write_durably(result.outputs["tables_json"], f"{dumps(tables)}\n".encode())
    result.summary = [f"{len(comparison.tables)} tables in {result.outputs['tables']}"]
    return result


class _Steps:
    """Print each step before it begins, with the time that is left for its table."""

    def __init__(self) -> None:
        self._began_s = 0.0

    def __call__(self, step: str, done: int, total: int, /) -> None:
        now_s = time.monotonic()
        if done == 0:
            self._began_s = now_s
            note(step)
            return
        left_s = (now_s - self._began_s) * (total - done) / done
        note(f"{step}; about {left_s:.0f} s left for this table")
