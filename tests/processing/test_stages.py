"""Every stage gives the same maps in memory and in bands with its maps in files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import DataError
from acquisition.files import BandStore, DamagedMapsError
from processing import NormalMap, ShapeFilter
from processing.detail import SeparationStage, TransferStage
from processing.stages import Stage, computed, run_steps
from processing.superres import SuperResolutionStage
from processing.synthesis import SynthesisStage
from tests.processing.scenes import waves
from tests.quick_sample import quick


def rough(height: int, width: int, seed: int = 1, *, hole: bool = False) -> NormalMap:
    """Waves with noise; with a hole, the first and last rows are empty, too."""
    y, x = np.mgrid[:height, :width]
    mask = np.ones((height, width), bool)
    if hole:
        up, across = y / height - 0.48, x / width - 0.5
        mask = ((across / 0.48) ** 2 + (up / 0.46) ** 2 < 1) & (across**2 + up**2 > 0.01)
    return waves((height, width), seed, (0.4, 0.3), (7, 9), mask=mask)


def bumps(height: int, width: int) -> NormalMap:
    """Smooth bumps, so that cuts between patches are seen."""
    coarse = np.random.default_rng(2).normal(size=(height, width))
    for axis in (0, 1):
        coarse = np.apply_along_axis(np.convolve, axis, coarse, np.hanning(9), "same")
    dy, dx = np.gradient(coarse)
    return NormalMap.from_vectors(np.dstack([-0.2 * dx, 0.2 * dy, np.ones(coarse.shape)]))


@dataclass(frozen=True)
class Case:
    """A stage with its inputs; ``rows`` forces the units of a band, unless the stage fixes them."""

    stage: Stage
    inputs: tuple[NormalMap, ...]
    rows: int | None = 37
    maps: tuple[str, ...] = ()


def transfer(size: tuple[int, int], **options: Any) -> Case:
    given = {"shape_filter": ShapeFilter(order=2, w=3), **options}
    stage = TransferStage(**given)
    inputs = rough(*size), rough(250, 90, 2, hole=True)
    return Case(stage, inputs, 40, (stage.result, "shape_error", "detail_error", "sums"))


def superres(low: tuple[int, int], scale: int, **options: Any) -> Case:
    stage = SuperResolutionStage.of(scale, **options)
    return Case(stage, (rough(*low, hole=min(low) > 9),), None)


def sheet(height: int, width: int, **options: Any) -> Case:
    stage = SynthesisStage((height, width), seed=4, **{"patch": 16, **options})
    return Case(stage, (bumps(96, 90),), None, ("sheet", "labels"))


RELIEF = rough(330, 150, hole=True)
CASES = {
    "separation": Case(SeparationStage(), (RELIEF,)),
    "separation, the paper's": Case(SeparationStage(ShapeFilter(order=1)), (RELIEF,), 1),
    "separation, wide": Case(SeparationStage(ShapeFilter(w=9, order=3)), (RELIEF,)),
    "separation, box": Case(SeparationStage(ShapeFilter("box")), (RELIEF,)),
    "separation, guided": Case(SeparationStage(ShapeFilter("guided")), (RELIEF,)),
    "separation, bilateral": Case(SeparationStage(ShapeFilter("bilateral")), (RELIEF,)),
    "transfer, cut both ways": transfer((61, 37)),
    "transfer, cut across": transfer((300, 37)),
    "transfer, cut downwards": transfer((40, 120)),
    "transfer, copies of more rows than a band": transfer((110, 60)),
    "transfer, plain": transfer((61, 37), tile="plain"),
    "transfer, mirrored": transfer((61, 37), tile="mirror", amplitude=-0.7),
    "transfer, larger source": transfer((330, 130)),
    "transfer, no detail": transfer((61, 37), amplitude=0.0),
    "transfer, put above and left": transfer((100, 60), at=(-20, -30)),
    "transfer, put at the end": transfer((100, 60), at=(50, 190), keep_target_detail=True),
    "transfer, one correction": transfer((61, 37), refine=1),
    "transfer, two corrections": transfer((61, 37), refine=2, at=(10, 30)),
    "transfer, three corrections": transfer((61, 37), refine=3, keep_target_detail=True),
    "transfer, box": transfer((61, 37), shape_filter=ShapeFilter("box", 1, 4), refine=1),
    "transfer, guided": transfer((61, 37), shape_filter=ShapeFilter("guided", 1, 4)),
    "super-resolution, eight copies": superres((150, 9), 4),
    "super-resolution, points": superres((270, 9), 2, sampling="points"),
    "super-resolution, bicubic": superres((390, 9), 4, method="bicubic"),
    "super-resolution, one pixel": superres((1, 1), 2),
    "sheet, three strips, two bands": sheet(550, 130),
    "sheet for tiling": sheet(550, 120, tileable=True),
    "sheet for tiling, one strip": sheet(150, 130, tileable=True),
    "sheet, turned and mirrored": sheet(300, 110, patch=12, rotate=True, mirror=True),
    "sheet too small to be filtered": sheet(90, 70),
    "sheet of one row": sheet(1, 70),
}
SOME = ["separation", "transfer, two corrections", "super-resolution, bicubic", "sheet for tiling"]


def opened(case: Case, folder: Path) -> BandStore:
    sizes = [given.size for given in case.inputs]
    return BandStore(folder / "out" / "maps", {}, case.stage.forms(*sizes))


def fill(case: Case, store: BandStore) -> list[tuple[int, int]]:
    """Compute what is missing in bands; return the progress."""
    seen: list[tuple[int, int]] = []
    steps = case.stage.steps(store, *case.inputs, memory=10**9)
    if case.rows is not None:
        steps = [replace(one, most=min(case.rows, one.units)) for one in steps]
    run_steps(case.stage.name, steps, store, lambda name, done, total: seen.append((done, total)))
    return seen


def check(case: Case, store: BandStore) -> None:
    whole = computed(case.stage, *case.inputs)
    for name in case.maps or whole:
        np.testing.assert_array_equal(store[name][:], whole[name][:], err_msg=name)


@pytest.mark.parametrize("name", quick(CASES, every=5))
def test_bands_are_the_whole(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    with opened(case, tmp_path) as store, store.filling():
        seen = fill(case, store)
        check(case, store)
        store.remove()
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert seen[0][0] == 0
    assert seen[-1] == (seen[0][1], seen[0][1])


@pytest.mark.parametrize("name", SOME)
def test_a_stage_continues_after_each_band(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is stopped when a band is written, but not named in the journal."""
    case, complete = CASES[name], BandStore.complete
    done: list[tuple[str, int]] = []
    left = 0

    def once(store: BandStore, step: str, units: slice) -> None:
        nonlocal left
        if not left:
            raise KeyboardInterrupt
        left -= 1
        complete(store, step, units)
        done.extend((step, unit) for unit in range(units.start, units.stop))

    monkeypatch.setattr(BandStore, "complete", once)
    for _ in range(200):
        left = 2
        with opened(case, tmp_path) as store:
            try:
                with store.filling():
                    fill(case, store)
            except KeyboardInterrupt:
                continue
            check(case, store)
            store.remove()
            break
    assert len(done) == len(set(done)) > 5


def deleted(file: Path) -> None:
    file.unlink()


def cut_off(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-9])


def flipped(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[5] ^= 1
    file.write_bytes(data)


@pytest.mark.parametrize("damage", [deleted, cut_off, flipped], ids=lambda one: one.__name__)
@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("separation", "shape"),
        ("transfer, two corrections", "source_detail"),
        ("super-resolution, bicubic", "added_deg"),
        ("sheet for tiling", "labels"),
    ],
)
def test_a_part_that_was_changed_meanwhile_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, file: str, damage: Any
) -> None:
    case, complete, count = CASES[name], BandStore.complete, iter(range(9))

    def stopped(store: BandStore, step: str, units: slice) -> None:
        if next(count) == 2:
            raise KeyboardInterrupt
        complete(store, step, units)

    with monkeypatch.context() as patched, opened(case, tmp_path) as store:
        patched.setattr(BandStore, "complete", stopped)
        with pytest.raises(KeyboardInterrupt), store.filling():
            fill(case, store)
    damage(store.folder / f"{file}.raw")
    with pytest.raises(DamagedMapsError, match=rf"{file}\.raw: .* since .* computed"):
        opened(case, tmp_path)
    sizes = [given.size for given in case.inputs]
    again = BandStore(tmp_path / "out" / "maps", {}, case.stage.forms(*sizes), replace=True)
    with again:
        fill(case, again)
        check(case, again)


@pytest.mark.parametrize(
    ("case", "text"),
    [
        (transfer((61, 37), at=(500, 0)), "does not reach the mask"),
        (transfer((61, 37), tile="round"), "unknown way of tiling"),
        (transfer((61, 37), shape_filter=ShapeFilter(w=30)), "larger than the normal map"),
        (sheet(0, 9), "has no pixels"),
        (sheet(90, 90, patch=200), "exemplar"),
        (sheet(90, 90, overlap=40), "out of range"),
        (sheet(20, 90, tileable=True), "at least 32 pixels"),
        (replace(sheet(90, 90), stage=SynthesisStage((90, 90), seed=-1)), "seed"),
        (superres((80, 9), 2, max_pixels=99), "18 x 160, 99 are allowed"),
    ],
    ids=lambda value: None,
)
def test_what_does_not_fit_is_refused_in_memory_and_in_files(
    tmp_path: Path, case: Case, text: str
) -> None:
    with pytest.raises(DataError, match=text):
        computed(case.stage, *case.inputs)
    with pytest.raises(DataError, match=text), opened(case, tmp_path) as store, store.filling():
        fill(case, store)
    assert not (tmp_path / "out").exists()


def test_cuts_of_a_large_rectangle_need_memory(tmp_path: Path) -> None:
    by = ShapeFilter(order=1, w=1)
    for tile in ("cut", "plain"):
        stage = TransferStage(shape_filter=by, tile=tile)
        inputs = rough(200, 80), rough(250, 90, 2)
        sizes = [given.size for given in inputs]
        with BandStore(tmp_path / tile, {}, stage.forms(*sizes)) as store:
            least = stage.need(*sizes).least
            if tile == "cut":
                with pytest.raises(DataError, match="80 x 200 pixels that are joined along cuts"):
                    stage.steps(store, *inputs, memory=least)
            else:
                stage.steps(store, *inputs, memory=least)


def test_bands_need_less_memory_and_edge_aware_filters_more() -> None:
    for side in (3000, 10000):
        for stage in (
            SuperResolutionStage.of(2, method="bicubic"),
            SuperResolutionStage.of(4),
            SeparationStage(),
            SynthesisStage((side, side)),
        ):
            size = (256, 256) if isinstance(stage, SynthesisStage) else (side, 2500)
            need = stage.need(size)
            assert need.least < need.whole / 1.1
    plain, guided = (
        SeparationStage(ShapeFilter(kind)).need((3000, 2000)) for kind in ("gaussian", "guided")
    )
    assert guided.whole - plain.whole > 6_000_000 * 100
