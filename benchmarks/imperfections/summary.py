"""What the table says: shares of right names, of warnings and of false alarms."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator

from benchmarks.imperfections.cases import NONE
from benchmarks.imperfections.table import Row, Table

_WIDTH = 22
# Most times of the clean error that a remedy leaves, and change in degrees that does not matter.
_HEALED, _SLIGHT = 1.3, 0.1


def summary(table: Table) -> Iterator[str]:
    """Yield the lines of the summary."""
    harmful = [(row, clean) for row, clean in table.imperfect() if row.harms(clean)]
    single = [row for row, _ in harmful if "+" not in row.key.case]
    pairs = [row for row, _ in harmful if "+" in row.key.case]
    shown = [row for row in single if row.shown]
    yield f"{len(list(table.imperfect()))} imperfect recordings, {len(harmful)} of them harmful"
    yield f"harmful and shown by the images: {_counts(shown)}"
    hidden = [row for row in single if not row.shown]
    known = sum(row.listed or row.named for row in hidden)
    yield f"harmful and not shown by them:   {known} of {len(hidden)} listed as not excluded"
    yield f"harmful pairs of imperfections:  {_counts(pairs)}"
    yield ""
    yield from _by("imperfection", shown, lambda row: row.key.case)
    yield ""
    yield from _by("scene", shown, lambda row: row.key.scene)
    yield ""
    yield "named instead:"
    instead: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for row in shown:
        if not row.named:
            instead[row.key.case][row.outcome.causes.split(" ")[0] or "nothing"] += 1
    for case, names in sorted(instead.items()):
        listed = ", ".join(f"{name} {count}" for name, count in names.most_common())
        yield f"{case:{_WIDTH}} {listed}"
    yield ""
    yield from _remedies(list(table.imperfect()))
    yield ""
    yield from _clean([row for row in table.rows.values() if row.key.case == NONE])


def _counts(rows: list[Row]) -> str:
    if not rows:
        return "none"
    named, warned = sum(row.named for row in rows), sum(row.warned for row in rows)
    return (
        f"{named} of {len(rows)} named ({named / len(rows):.1%}), {warned} with a warning "
        f"({warned / len(rows):.1%})"
    )


def _by(title: str, rows: Iterable[Row], of: Callable[[Row], str]) -> Iterator[str]:
    groups: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        groups[of(row)].append(row)
    yield f"{title:{_WIDTH}} harmful   named  warned"
    for name, group in groups.items():
        named, warned = sum(row.named for row in group), sum(row.warned for row in group)
        yield f"{name:{_WIDTH}} {len(group):7d} {named:7d} {warned:7d}"


def _remedies(rows: list[tuple[Row, Row]]) -> Iterator[str]:
    """Yield what the options did that remedies name."""
    tried = [(row, clean) for row, clean in rows if row.outcome.remedy and row.has_truth]
    healed = [
        row for row, clean in tried if row.outcome.remedied_deg <= _HEALED * clean.outcome.error_deg
    ]
    worse = [row for row, _ in tried if row.outcome.remedied_deg > row.outcome.error_deg + _SLIGHT]
    yield f"{len(tried)} remedies: {len(healed)} give at most {_HEALED} times the clean error"
    yield f"{len(worse)} of them make the error worse by more than {_SLIGHT} degrees:"
    for row in worse:
        yield f"  {row} {row.outcome.remedy}: {row.outcome.remedied_deg:.2f} deg"


def _clean(rows: list[Row]) -> Iterator[str]:
    simulated = [row for row in rows if row.key.seed != "0"]
    answers = Counter(row.outcome.answer for row in simulated)
    listed = ", ".join(f"{count} {answer}" for answer, count in answers.most_common())
    yield f"{len(simulated)} clean simulated recordings: {listed or 'none'}"
    for row in rows:
        if row.warned or row not in simulated:
            name = f"{row.key.scene} {row.key.seed}"
            yield f"{name:{_WIDTH}} {row.lights}: {row.outcome.answer} {row.outcome.causes}"
