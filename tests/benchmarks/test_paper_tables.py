"""The paper's tables: their contents, and their notes about missing data."""

from __future__ import annotations

import csv
import json
import os
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from acquisition import angle_deg
from benchmarks.paper import __main__ as command
from benchmarks.paper import figures as paper
from benchmarks.paper import run as _paper_run
from benchmarks.paper import sources as _paper_sources
from benchmarks.paper import surface
from benchmarks.paper.comparison import Comparison
from benchmarks.paper.faces import FACES
from benchmarks.paper.measure import METHODS, measure
from benchmarks.paper.sources import DILIGENT, Sources, bowl
from benchmarks.paper.tables import Table, markdown
from processing import NormalMap, ShapeFilter, combine, separate
from rig import no_progress
from sgp import read_record
from tests.quick_sample import quick

needs_data = pytest.mark.skipif("SGP_DATA" not in os.environ, reason="SGP_DATA is not set")


def ripples(size: int = 70) -> NormalMap:
    y, x = np.mgrid[:size, :size].astype(np.float64)
    slopes = [0.4 * np.cos(x * 2 * np.pi / 7), 0.4 * np.sin(y * 2 * np.pi / 7), np.ones_like(x)]
    return NormalMap.from_vectors(np.stack(slopes, axis=2))


STAND_INS = ("scales", "cloth")


def check_curve(path: Path, rms: float) -> None:
    """Check that the listed points are a subset of all points, including both ends."""
    pixel, target, result, smoothed = np.loadtxt(path, delimiter=",", skiprows=1).T
    assert len(pixel) == 4000
    assert pixel[0] == 0
    assert pixel[-1] > 4000
    assert (np.diff(target) >= 0).all()
    assert np.sqrt(np.mean((result - target) ** 2)) == pytest.approx(rms, rel=0.1)
    assert np.std(smoothed - target) < np.std(target)


def read_tables(folder: Path, *groups: str) -> tuple[dict, str]:
    """Return the tables of groups, and their text."""
    made, text = {}, ""
    for group in groups:
        made |= json.loads((folder / group / "tables.json").read_text(encoding="utf-8"))
        text += (folder / group / "tables.md").read_text(encoding="utf-8")
    return made, text


def check(made: dict, markdown_text: str) -> None:
    for table in made.values():
        assert table["title"] in markdown_text
        assert table["note"] in markdown_text
        for columns, rows in (("columns", "rows"), ("paper_columns", "paper_rows")):
            assert table[rows]
            for name, row in table[rows].items():
                assert len(row) == len(table[columns]), (table["key"], name)


# Row names from before the round trip had a row: programs that read tables.json use them.
ROWS = [
    f"{quantity}, {method}"
    for quantity in (
        "shape error, deg", "shape SSIM", "detail error, deg", "detail SSIM", "memory, MB",
        "time, s",
    )
    for method in ("DSPL", "LAPL", "normals", "normals, order 8")
]  # fmt: skip


def check_peers_rows(table: dict, spread: dict) -> None:
    """Check old rows, the floor, the measures with equal conditions, and the spread of costs."""
    rows = table["rows"]
    assert set(ROWS) <= set(rows)
    for part in ("shape", "detail"):
        for method in ("DSPL", "LAPL", "normals", "normals, order 8"):
            same, surface = (
                rows[f"{part} error {name}, deg, {method}"]
                for name in ("from the same surfaces", "as surfaces")
            )
            # The result of a mesh method is already a surface.
            assert (same == surface) == (not method.startswith("normals"))
        floor = rows[f"{part} error, deg, round trip without transfer"]
        assert all(0 <= cell < 10 for cell in floor)
    # Most of the plain error of a mesh method is the error of the round trip.
    for method in ("DSPL", "LAPL"):
        for place, floor in enumerate(rows["detail error, deg, round trip without transfer"]):
            plain = rows[f"detail error, deg, {method}"][place]
            assert plain > 0.9 * floor
            assert rows[f"detail error as surfaces, deg, {method}"][place] < plain
    assert spread["columns"] == table["columns"]
    for method in ("DSPL", "LAPL", "normals", "normals, order 8"):
        for quantity in ("time of a first call, s", "time of a repeated call, s"):
            least, middle, most = (
                spread["rows"][f"{quantity}, {name}, {method}"]
                for name in ("least", "median", "most")
            )
            assert least <= middle <= most
            assert min(least) >= 0


@pytest.fixture
def small(monkeypatch):
    """Use the smallest number of points, and skip the largest textures."""
    textures = Sources.textures
    monkeypatch.setattr(_paper_run, "_QUICK_POINTS", 6000)
    monkeypatch.setattr(
        Sources,
        "textures",
        lambda self: {
            name: normal_map
            for name, normal_map in textures(self).items()
            if name not in ("plant", "carving (simulated)")
        },
    )


@pytest.fixture
def asked(monkeypatch) -> list[dict[str, object]]:
    """Return the options of every call; nothing is computed."""
    calls = []

    def note_options(*, advance, **given):
        calls.append(given)
        return Comparison("# Tables")

    for name, (_, options) in command.TABLES.items():
        monkeypatch.setitem(command.TABLES, name, (note_options, options))
    return calls


def test_the_record_has_the_parameters_and_what_the_group_took(asked, tmp_path):
    assert command.main(["--out", str(tmp_path), "--quick"]) == 0
    assert len(asked) == len(command.TABLES)
    found = read_record(tmp_path / "transfer" / "bench.json")
    assert found.command == "python -m benchmarks.paper --table transfer"
    assert found.parameters == {"quick": True, "runs": None}
    assert found.metrics["tables"] == 0
    assert set(found.metrics) == {"tables", "wall_s", "cpu_s", "peak_mb"}
    page = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert all(f"| {group} |" in page for group in command.TABLES)


def test_a_group_that_is_done_is_not_repeated(asked, tmp_path, capsys):
    words = ["--table", "surface", "--out", str(tmp_path)]
    assert command.main(words) == command.main(words) == 0
    assert len(asked) == 1
    assert "surface: done before" in capsys.readouterr().err
    assert command.main([*words, "--quick"]) == 2
    assert "made with other options: give another --out" in capsys.readouterr().err
    assert command.main([*words, "--quick", "--force"]) == 0
    assert len(asked) == 2
    # The other groups are added to the same page.
    assert command.main(["--out", str(tmp_path), "--quick"]) == 0
    assert len(asked) == 1 + len(command.TABLES)


def test_options_reach_their_tables(asked, tmp_path):
    for index, words in enumerate(
        ("--table transfer", "--table transfer --quick --runs 4", "--table synthesis",
         "--table synthesis --quick --seed 3",
         f"--table superres --models {tmp_path / '0'}")
    ):  # fmt: skip
        assert command.main(["--out", str(tmp_path / str(index)), *words.split()]) == 0
    assert asked == [
        {"quick": False, "runs": None},
        {"quick": True, "runs": 4},
        {"quick": False, "seed": 7},
        {"quick": True, "seed": 3},
        {"quick": False, "seed": 7, "models": tmp_path / "0"},
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--runs 0", "invalid number value: '0'"),
        ("--table synthesis --seed -1", "invalid number value: '-1'"),
        ("--table nonsense", "invalid choice: 'nonsense'"),
        ("--table superres --runs 2", "--runs is not an option of --table superres"),
        ("--table transfer --models .", "--models is not an option of --table transfer"),
    ],
)
def test_bad_options_are_refused(asked, tmp_path, capsys, words, message):
    with pytest.raises(SystemExit) as ended:
        command.main(["--out", str(tmp_path / "out"), *words.split()])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err
    assert asked == []


def test_folders_that_cannot_be_used_are_refused_before_the_work(asked, tmp_path, capsys):
    (tmp_path / "surface").mkdir()
    (tmp_path / "surface" / "a").write_text("kept")
    words = ["--table", "surface", "--out", str(tmp_path)]
    assert command.main(words) == 2
    assert "already contains files" in capsys.readouterr().err
    other = f"--table superres --models {tmp_path / 'none'} --out {tmp_path / 'b'}".split()
    assert command.main(other) == 2
    assert "no such folder" in capsys.readouterr().err
    assert asked == []
    assert command.main([*words, "--force"]) == 0
    assert (tmp_path / "surface" / "a").read_text() == "kept"


def test_steps_state_the_time_left(monkeypatch):
    lines, clock = [], iter([100.0, 106.0, 110.0])
    monkeypatch.setattr(command, "note", lines.append)
    monkeypatch.setattr(command.time, "monotonic", lambda: next(clock))
    steps = command._Steps()
    steps("a", 0, 40)
    steps("b", 10, 40)
    steps("c", 0, 2)
    assert lines == ["a", "b; about 18 s left for this table", "c"]


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_without_data_the_tables_are_simulated_and_say_so(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("SGP_DATA", raising=False)
    for group in ("properties", "transfer"):
        assert command.main(["--out", str(tmp_path), "--quick", "--table", group]) == 0
    said = capsys.readouterr().err
    assert "warning: SGP_DATA is not set" in said
    assert "note: --quick" in said
    assert "cloth (simulated)" in said
    made, text = read_tables(tmp_path, "properties", "transfer")
    assert set(made) == {
        "shape_similarity", "separability", "idempotence", "cross_exchange", "resolution",
        "resolution_spread", "headline", "height_profile",
    }  # fmt: skip
    check(made, text)
    check_peers_rows(made["resolution"], made["resolution_spread"])
    assert "Note: SGP_DATA is not set" in text
    # Both cells of the headline are missing, so it must not have a value.
    assert made["headline"]["rows"]["normals"] == [None] * 4
    assert made["headline"]["columns"][:2] == ["memory ratio", "time ratio"]
    assert (tmp_path / "transfer" / "resolution.png").stat().st_size > 10_000
    assert read_record(tmp_path / "transfer" / "bench.json").inputs == {}
    heights = made["height_profile"]
    assert heights["columns"] == [f"{name} (simulated) on bowl (simulated)" for name in STAND_INS]
    assert (tmp_path / "transfer" / "height_profile.png").stat().st_size > 10_000
    for name, rms in zip(STAND_INS, heights["rows"]["rms of result less target, px"], strict=True):
        check_curve(tmp_path / "transfer" / f"height_profile_{name}.csv", rms)


@needs_data
@pytest.mark.timeout(900)
@pytest.mark.usefixtures("small")
@pytest.mark.slow
def test_with_data_every_table_of_transfers_is_there(tmp_path, monkeypatch):
    # Half of the objects: the others come from the same functions.
    monkeypatch.setattr(_paper_sources, "DILIGENT", DILIGENT[:3])
    assert command.main(["--out", str(tmp_path), "--quick", "--table", "transfer"]) == 0
    made, text = read_tables(tmp_path, "transfer")
    check(made, text)
    for key in ("diligent", "diligent_owl"):
        assert made[key]["columns"] == list(DILIGENT[:3])
        check_peers_rows(made[key], made[f"{key}_spread"])
    # With the same measure, the mean detail errors of both domains are similar on real maps.
    for key in ("diligent", "diligent_owl"):
        for method in ("DSPL", "LAPL"):
            for measure_name in ("from the same surfaces", "as surfaces"):
                ours, peer = (
                    np.mean(made[key]["rows"][f"detail error {measure_name}, deg, {name}"])
                    for name in ("normals", method)
                )
                assert 0.75 < ours / peer < 1.25
    variants = made["diligent_variants"]["rows"]
    assert variants["owl, order 8 (default): detail error, deg"][-1] <= 1.7
    assert variants["plant, order 8 (default): shape error, deg"][-1] <= 2.8
    inputs = read_record(tmp_path / "transfer" / "bench.json").inputs
    names = {Path(name).relative_to(os.environ["SGP_DATA"]).parts[0] for name in inputs}
    assert names == {"meshes", "normals", "reliefs"}
    for name, digest in inputs.items():
        assert sha256(Path(name).read_bytes()).hexdigest() == digest
    local = made["local"]["rows"]
    for method in ("normals", "DSPL", "LAPL"):
        assert f"detail error, deg, {method}" in local
        assert f"detail SSIM, {method}" in local
        assert f"detail error as surfaces, deg, {method}" in local
    assert tuple(made["local"]["columns"]) == tuple(FACES)
    assert max(local["step across the seam over the interior's, normals"]) <= 1.2


@pytest.mark.parametrize(
    ("quick", "runs", "used"), [(False, None, 10), (True, None, 1), (True, 4, 4)]
)
def test_the_number_of_runs_depends_on_quick(monkeypatch, quick, runs, used):
    def note_runs(sources, points, runs, advance):
        raise ArithmeticError(runs)

    monkeypatch.delenv("SGP_DATA", raising=False)
    monkeypatch.setattr(Sources, "textures", lambda self: {"a": bowl(300), "b": bowl(300)})
    monkeypatch.setattr(_paper_run, "by_resolution", note_runs)
    with pytest.raises(ArithmeticError, match=str(used)):
        _paper_run.run_transfers(quick=quick, runs=runs, advance=no_progress)


@pytest.mark.parametrize("method", quick([*METHODS, "LAPL, direct solver"], every=6))
def test_a_measured_transfer_is_the_transfer(method):
    source, target = ripples(), bowl(3000)
    source = NormalMap(
        source.normals[: target.size[0], : target.size[1]],
        source.mask[: target.size[0], : target.size[1]],
    )
    measured = measure([method], source, target, runs=2)[method]
    assert len(measured.cpu_s) == len(measured.again_cpu_s) == 2
    assert min(measured.cpu_s) >= 0
    assert min(measured.again_cpu_s) >= 0
    assert len(measured.peak_bytes) in (0, 2)
    assert all(0 < size < 1e9 for size in measured.peak_bytes)
    assert (measured.normal_map.mask == target.mask).all()
    order = 8 if "8" in method else 1
    inside = NormalMap(np.where(target.mask[..., None], source.normals, 0), target.mask)
    meant = combine(
        separate(target, shape_filter=ShapeFilter(order=order)).shape,
        separate(inside, shape_filter=ShapeFilter(order=order)).detail,
    )
    error = angle_deg(measured.normal_map.normals, meant.normals)[target.mask]
    # The meshes lose detail that triangles one pixel wide cannot represent.
    assert error.mean() < (1e-3 if method.startswith("normals") else 7)


@pytest.mark.slow
def test_an_isolated_pixel_is_not_changed():
    source, whole = ripples(), ripples()
    mask = whole.mask.copy()
    mask[39:42, 49:52] = False
    mask[40, 50] = True
    target = NormalMap(np.where(mask[..., None], whole.normals, 0), mask)
    for measured in measure(["DSPL", "LAPL"], source, target).values():
        made = measured.normal_map.normals
        np.testing.assert_array_equal(made[40, 50], target.normals[40, 50])
        assert angle_deg(made[mask], target.normals[mask]).mean() < 12


def test_a_bowl_has_the_requested_number_of_points():
    for points in (5010, 49532):
        made = bowl(points)
        assert np.count_nonzero(made.mask) == pytest.approx(points, rel=0.02)
        tilt = np.degrees(
            np.arctan2(np.hypot(*made.normals[made.mask, :2].T), made.normals[made.mask, 2])
        )
        assert tilt.max() == pytest.approx(60, abs=1)


@needs_data
def test_files_that_were_read_are_listed():
    sources = Sources.found()
    sources.given("diligent/cat")
    sources.resolution_pair(5010)
    root = Path(os.environ["SGP_DATA"])
    assert sorted(str(file.relative_to(root)) for file in sources.files) == [
        "meshes/stanford-bunny.obj",
        "normals/diligent/cat/mask.png",
        "normals/diligent/cat/normal_map.png",
        "reliefs/160.jpg",
    ]


@needs_data
def test_the_bunny_has_the_requested_number_of_points():
    name, source, target = Sources.found().resolution_pair(5010)
    assert name == "cracks onto bunny"
    assert np.count_nonzero(target.mask) == pytest.approx(5010, rel=0.02)
    assert source.size == (1024, 1024)


def test_the_papers_ratios_come_from_its_own_cells():
    many, few = (paper.POINTS.index(count) for count in paper.HEADLINE_POINTS)
    for quantity, printed in (
        ("memory, MB", paper.HEADLINE_MEMORY),
        ("time, s", paper.HEADLINE_TIME),
    ):
        cells = paper.RESOLUTION[quantity]
        assert cells["normals"][many] / cells["LAPL"][few] == pytest.approx(printed, abs=5e-4)


@pytest.mark.parametrize(
    ("quantity", "method", "mean"),
    [
        ("shape error, deg", "DSPL", 5.48),
        ("shape error, deg", "LAPL", 3.56),
        ("shape error, deg", "normals", 2.24),
        ("detail error, deg", "DSPL", 21.15),
        ("detail error, deg", "LAPL", 18.31),
        ("detail error, deg", "normals", 6.07),
        ("memory, MB", "DSPL", 306.73),
        ("memory, MB", "LAPL", 11833.11),
        ("memory, MB", "normals", 19.59),
        ("time, s", "DSPL", 4.79),
        ("time, s", "LAPL", 689.01),
        ("time, s", "normals", 0.48),
    ],
)
def test_the_papers_table_has_the_means_that_its_text_states(quantity, method, mean):
    row = paper.DILIGENT[quantity][method]
    assert len(row) == len(paper.DILIGENT_TARGETS)
    assert np.mean(row) == pytest.approx(mean, rel=2e-3, abs=0.006)


def test_markdown_has_a_line_for_each_row_and_says_what_is_missing():
    table = Table(
        "key", "Title", ("a", "b"), {"row": [0.1239, None]}, "Note.", ("c",), {"theirs": [1234.6]}
    )
    text = markdown(table)
    assert "| row | 0.1239 | n/a |" in text
    assert "| theirs | 1235 |" in text
    assert text.endswith("Note.")


MEASURED = Path(__file__).parents[2] / "docs" / "measured"


def figures(path: Path) -> dict[tuple[str, str, str, str], float | None]:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return {(a, b, c, d): float(value) if value else None for a, b, c, d, value in rows}


def test_the_page_in_docs_has_all_groups_and_the_figures_of_its_tables():
    known = figures(MEASURED / "paper.csv")
    assert {key[0] for key in known} == set(command.TABLES)
    page = (MEASURED / "paper.md").read_text(encoding="utf-8")
    for key in command.ON_PAGE:
        rows = {row for _, table, row, _ in known if table == key}
        assert rows, key
        assert all(f"| {row} |" in page for row in rows)


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("group", ["properties", "surface"])
def test_the_figures_in_docs_are_those_of_the_command(group, tmp_path, monkeypatch):
    # Costs are not compared, so those of one object stand for all.
    of_one, measured = surface.costs, {}

    def costs(system, *given):
        if system.name not in measured:
            measured[system.name] = of_one(system, *given)
        return measured[system.name]

    monkeypatch.setattr(surface, "costs", costs)
    # A part of the forms and objects; the other rows come from the same functions.
    monkeypatch.setattr(
        surface, "FORMS", {name: surface.FORMS[name] for name in ("peaks", "plane")}
    )
    monkeypatch.setattr(surface, "DILIGENT", DILIGENT[::2])
    assert command.main(["--table", group, "--out", str(tmp_path), "--quick"]) == 0
    made, known = (figures(folder / "paper.csv") for folder in (tmp_path, MEASURED))
    assert len(made) > 40
    for key in made:
        value = known[key]
        if key[3].endswith("CPU s") or key[3].startswith("MB"):
            continue  # costs depend on the machine
        assert made[key] == (None if value is None else pytest.approx(value, rel=0.02, abs=0.02)), (
            key
        )
