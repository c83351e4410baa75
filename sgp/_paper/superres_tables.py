"""Tables of super-resolution: errors of normals and heights, and predicted deviations."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

import numpy as np

from sgp._paper import figures as paper
from sgp._paper.superres_judge import DOMAINS, Domain, Judgement, Networks
from sgp._paper.tables import Number, Table

# For each map: its class, its name, and its errors.
Found = Sequence[tuple[str, str, Judgement]]


def errors(scale: int, found: Found, networks: Networks) -> Table:
    """Return the mean angular errors, and by how much networks change them."""
    columns = ["bicubic, deg"]
    for domain in networks:
        columns += [f"{domain}, deg", "change, %", "its spread over seeds, points"]
    rows: dict[str, list[Number]] = {}
    for _, name, one in found:
        rows[name] = [one.bicubic_deg]
        for domain in networks:
            changes = one.changes(domain)
            spread = max(changes) - min(changes) if len(changes) > 1 else None
            mean = statistics.mean(one.by_domain[domain])
            rows[name] += [mean, statistics.mean(changes), spread]
    for kind in dict.fromkeys(kind for kind, _, _ in found):
        row = rows[f"**{kind}**, mean of changes"] = [None]
        of_kind = [one for each, _, one in found if each == kind]
        for domain in networks:
            row += [None, statistics.mean(_mean_change(one, domain) for one in of_kind), None]
    seeds = ", ".join(
        f"{domain}: {', '.join(model.name for model in models)}"
        for domain, models in networks.items()
    )
    note = (
        "Mean angle to the map over its complete mask, and its mean over the networks of each "
        f"domain ({seeds}). {_verdict(found, networks)} The paper's surfaces, its 353 maps for "
        "training and its network of 22 million parameters are others, and it prints no errors of "
        "bicubic interpolation: only the order of its methods can be compared."
    )
    return Table(
        f"errors_x{scale}",
        f"Scale {scale}: errors of normals",
        tuple(columns),
        rows,
        paper.SUPERRES_COLUMNS if scale == 4 else (),
        paper.SUPERRES if scale == 4 else {},
        note,
    )


def heights(scale: int, found: Found, networks: Networks) -> Table:
    """Return the errors of heights after integration."""
    columns = ["bicubic, px"]
    for domain in networks:
        columns += [f"{domain}, px", "change, %"]
    rows: dict[str, list[Number]] = {}
    for _, name, one in found:
        plain = one.heights["bicubic"]
        rows[name] = [plain]
        for domain in networks:
            own = one.heights[domain]
            rows[name] += [own, 100 * (own / plain - 1) if plain else None]
    note = (
        "Root mean square difference between the surfaces of the enlarged map and of the map, each "
        "part placed at its mean height, in pixels of the map; the first network of each domain."
    )
    title = f"Scale {scale}: errors of heights"
    return Table(f"heights_x{scale}", title, tuple(columns), rows, (), {}, note)


def deviations(scale: int, found: Found) -> Table:
    """Return the actual over the predicted deviations."""
    rows: dict[str, Sequence[Number]] = {
        name: [*one.ratios, one.invented] for _, name, one in found if one.ratios
    }
    note = (
        "Actual root mean square error over the predicted one, for tenths of the pixels with "
        "increasing prediction, of the first network. 1 is exact; above 1, errors are larger than "
        "predicted. The last column is the share of the detail that the network added."
    )
    columns = (*(f"tenth {number}" for number in range(1, 11)), "invented")
    title = f"Scale {scale}: actual over predicted deviation"
    return Table(f"deviations_x{scale}", title, columns, rows, (), {}, note)


def _mean_change(one: Judgement, domain: Domain) -> float:
    return statistics.mean(one.changes(domain))


def _verdict(found: Found, networks: Networks) -> str:
    """Say which domain has the smaller errors, and whether seeds of the training explain it."""
    if len(networks) < len(DOMAINS):
        return "Networks of one domain only were available, so the domains are not compared."
    given = [one for kind, _, one in found if kind != "smooth"]
    of = {domain: [_mean_change(one, domain) for one in given] for domain in DOMAINS}
    means = {domain: statistics.mean(changes) for domain, changes in of.items()}
    better, worse = sorted(DOMAINS, key=lambda domain: means[domain])
    wins = sum(a < b for a, b in zip(of[better], of[worse], strict=True))
    # For each seed of the training, the mean over the maps.
    by_seed = {
        domain: np.mean([one.changes(domain) for one in given], axis=0).tolist()
        for domain in DOMAINS
    }
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


_SAID = {"detail": "details", "normals": "plain normals"}
