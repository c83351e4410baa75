"""Tables of super-resolution: errors of normals and heights, and predicted deviations."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

import numpy as np

import processing
from benchmarks.paper import figures as paper
from benchmarks.paper.superres_judge import DOMAINS, Domain, Judgement, Networks
from benchmarks.paper.tables import Number, Table
from sgp.training import judgement

# For each map: its class, its name, and its errors.
Found = Sequence[tuple[str, str, Judgement]]
# Seeds of random surfaces, and the errors over all of them.
Random = tuple[range, judgement.Judgement]

# The classes over which the mean of the changes is given.
_REAL = ("reliefs", "captured")


def errors(own: processing.SuperResolutionModel, found: Found, random: Random) -> Table:
    """Return the errors of bicubic interpolation and of the network of the program."""
    seeds, over = random
    rows: dict[str, list[Number]] = {
        name: [
            one.bicubic_deg,
            one.own_deg,
            one.change,
            one.heights["bicubic"],
            one.heights["own"],
            one.height_change("own"),
        ]
        for _, name, one in found
    }
    rows[_named(seeds)] = [over.bicubic_deg, over.network_deg, 100 * over.change, *[None] * 3]
    kinds = list(dict.fromkeys(kind for kind, _, _ in found))
    groups: dict[str, tuple[str, ...]] = {f"**{kind}**": (kind,) for kind in kinds}
    if set(_REAL) <= set(kinds):
        groups["**reliefs and captured**"] = _REAL
    for name, group in groups.items():
        of_group = [one for kind, _, one in found if kind in group]
        normals = statistics.mean(one.change for one in of_group)
        heights = statistics.mean(one.height_change("own") for one in of_group)
        rows[f"{name}, mean of changes"] = [None, None, normals, None, None, heights]
        if group == _REAL:
            pixels = [one.pixels for one in of_group]
            bicubic = float(np.average([one.bicubic_deg for one in of_group], weights=pixels))
            network = float(np.average([one.own_deg for one in of_group], weights=pixels))
            change = 100 * (network / bicubic - 1)
            rows[f"{name}, all pixels together"] = [bicubic, network, change, *[None] * 3]
    note = (
        f"The network is {own.name} (on {_SAID[own.domain]}). Normals: mean angle to the map over "
        "its complete mask. Heights: root mean square difference between the surfaces of the "
        "enlarged map and of the map, each part placed at its mean height."
    )
    columns = (
        *("bicubic, deg", "network, deg", "change, %"),
        *("heights: bicubic, px", "network, px", "change, %"),
    )
    title = f"Scale {own.scale}: errors"
    return Table(f"errors_x{own.scale}", title, columns, rows, note)


def domains(scale: int, found: Found, compared: Networks) -> Table:
    """Return by how much networks on details and on plain normals change the errors."""
    columns: list[str] = []
    for domain in compared:
        columns += [f"{domain}: change, %", "spread over seeds, points", "of heights, %"]
    rows: dict[str, list[Number]] = {}
    for _, name, one in found:
        rows[name] = []
        for domain in compared:
            rows[name] += [*_over_seeds(one.changes(domain)), one.height_change(domain)]
    for kind in dict.fromkeys(kind for kind, _, _ in found):
        row = rows[f"**{kind}**, mean of changes"] = []
        of_kind = [one for each, _, one in found if each == kind]
        for domain in compared:
            heights = statistics.mean(one.height_change(domain) for one in of_kind)
            row += [*_over_seeds(_by_seed(of_kind, domain)), heights]
    named = "; ".join(
        f"{domain}: {', '.join(model.name for model in models)}"
        for domain, models in compared.items()
    )
    note = (
        f"Means over the networks of each domain ({named}); heights of the first one. "
        f"{_verdict(found, compared)} The paper's surfaces, its 353 maps for training and its "
        "network of 22 million parameters are others, and it prints no errors of bicubic "
        "interpolation: only the order of its methods can be compared."
    )
    return Table(
        f"domains_x{scale}",
        f"Scale {scale}: networks on details and on plain normals",
        tuple(columns),
        rows,
        note,
        paper.SUPERRES_COLUMNS if scale == 4 else (),
        paper.SUPERRES if scale == 4 else {},
    )


def deviations(scale: int, found: Found, random: Random) -> Table:
    """Return the actual over the predicted deviations."""
    seeds, over = random
    rows: dict[str, Sequence[Number]] = {_named(seeds): [*over.actual_over_predicted, None]}
    rows |= {name: [*one.ratios, one.invented] for _, name, one in found}
    note = (
        "Actual root mean square error over the predicted one, for tenths of the pixels with "
        "increasing prediction. 1 is exact; above 1, errors are larger than predicted. The "
        "predictions were corrected by errors on other random surfaces. The last column is the "
        "share of the detail that the network added."
    )
    columns = (*(f"tenth {number}" for number in range(1, 11)), "invented")
    title = f"Scale {scale}: actual over predicted deviation"
    return Table(f"deviations_x{scale}", title, columns, rows, note)


def _named(seeds: range) -> str:
    return f"random surfaces {seeds[0]} to {seeds[-1]}"


def _by_seed(found: Sequence[Judgement], domain: Domain) -> list[float]:
    """Return the mean change over maps for each seed of the training."""
    changes: list[float] = np.mean([one.changes(domain) for one in found], axis=0).tolist()
    return changes


def _over_seeds(changes: Sequence[float]) -> list[Number]:
    """Return the mean over seeds, and how far they differ."""
    spread = max(changes) - min(changes) if len(changes) > 1 else None
    return [statistics.mean(changes), spread]


def _mean_change(one: Judgement, domain: Domain) -> float:
    return statistics.mean(one.changes(domain))


def _verdict(found: Found, compared: Networks) -> str:
    """Say which domain has the smaller errors, and whether seeds of the training explain it."""
    if len(compared) < len(DOMAINS):
        return "All networks are of one domain, so the domains are not compared."
    # A network that was trained longer would win for that reason.
    kinds = {
        (model.training.get("preset"), model.training.get("steps"))
        for models in compared.values()
        for model in models
    }
    if len(kinds) > 1:
        return "The networks were not trained alike, so the domains are not compared."
    given = [one for kind, _, one in found if kind != "smooth"]
    of = {domain: [_mean_change(one, domain) for one in given] for domain in DOMAINS}
    means = {domain: statistics.mean(changes) for domain, changes in of.items()}
    better, worse = sorted(DOMAINS, key=lambda domain: means[domain])
    wins = sum(a < b for a, b in zip(of[better], of[worse], strict=True))
    by_seed = {domain: _by_seed(given, domain) for domain in DOMAINS}
    text = (
        f"Without the smooth shapes, networks on {_SAID[better]} change the error by "
        f"{means[better]:+.1f} % on average and those on {_SAID[worse]} by {means[worse]:+.1f} %; "
        f"{_SAID[better]} win on {wins} of {len(given)} maps"
    )
    if min(map(len, by_seed.values())) == 1:
        return f"{text}. There is only one seed, so this may be chance."
    if max(by_seed[better]) < min(by_seed[worse]):
        return f"{text}, and their worst seed is better than the best one on {_SAID[worse]}."
    return f"{text}, but seeds of one domain differ as much as the domains do: neither wins."


_SAID: dict[Domain, str] = {"detail": "details", "normals": "plain normals"}
