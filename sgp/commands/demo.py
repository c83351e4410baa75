"""``sgp demo``: from capture to surface on the simulated rig, compared with the ground truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import calibration
import processing
import rig
import simulator
from rig.arrays import Float32
from sgp.cli.console import Stages, note
from sgp.cli.options import Seed
from sgp.pictures import map_panel, signed_panel, source_title, spheres_panel, write_overview
from sgp.report import write_report
from sgp.results import DemoFolder, DemoMetrics, ErrorMetrics, Result, claimed, write_record
from sgp.stages import Outcome, RunOptions, Stopwatch, processed

_LONG_US, _SHORT_US = 20_000.0, 40.0


def demo(*, out: Path = Path("demo"), seed: Seed = 0, force: bool = False) -> Result:
    """Record and process a simulated object, and compare every result with the ground truth.

    The simulated rig, which uses the real serial protocol, records chrome spheres, from which the
    lights are calibrated, and a coin, from which normals, detail and a surface are computed.

    For example:

        sgp demo --out demo --seed 1

    Parameters
    ----------
    out
        Folder for all results; files of an earlier demo in it are replaced.
    seed
        Seed of the coin, the spread of the lights and the noise.
    force
        Write into a folder that already contains other files.
    """
    with claimed(out, force=force) as folder:
        return _demo(out, seed, folder)


def _demo(out: Path, seed: int, folder: DemoFolder) -> Result:
    watch = Stopwatch()
    with watch.stage("render"):
        note("rendering the scenes")
        scenes = {name: simulator.scene_named(name, seed=seed) for name in ("spheres", "coin")}
        truth = {name: simulator.render(scene) for name, scene in scenes.items()}
    with watch.stage("capture"):
        folder.begin("calibration")
        spheres = _capture(
            out / "calibration", scenes["spheres"], truth["spheres"], seed, (_LONG_US, _SHORT_US)
        )
        folder.begin("recording")
        coin = _capture(out / "recording", scenes["coin"], truth["coin"], seed + 1, (_LONG_US,))
    folder.begin("camera.json", "lights.json")
    acquisition.write_camera(out / "camera.json", simulator.bench_camera())
    with watch.stage("calibrate"):
        estimate, lights, brightest = _calibrate(spheres, scenes["spheres"])
        acquisition.write_lights(out / "lights.json", lights)
    source = acquisition.read_source(coin.folder, lights=lights)
    folder.begin("normals", "detail", "surface")
    # The hashes of these files identify the sessions.
    marks = [session.folder / "COMPLETE" for session in (spheres, coin)]
    with processed(
        source, marks, out, watch, RunOptions(), true_lights=scenes["coin"].lights
    ) as outcome:
        pass
    result = outcome.result
    result.warnings[:0] = estimate.warnings
    errors = _Errors(lights, outcome, truth["coin"])
    folder.begin("overview.png", "report.html", "summary.json")
    with watch.stage("overview"):
        panels, crop = outcome.panels, outcome.crop
        panels += [
            map_panel(
                f"normal error, mean {errors.normals.mae_deg:.2f} deg",
                errors.normals.map_deg,
                "deg",
                crop,
                error=True,
            ),
            signed_panel(
                f"height error, mean {errors.height_mae_mm:.3f} mm",
                errors.height_map_mm,
                "mm",
                crop,
            ),
            spheres_panel("chrome spheres and highlights", brightest, estimate),
        ]
        write_overview(out / "overview.png", source_title(source, f"coin, seed {seed}"), panels)
    result.summary += errors.table()
    with watch.stage("report"):
        write_report(out / "report.html", out, result, rig.MAX_PIXELS)
    metrics: DemoMetrics = {**outcome.metrics, **errors.metrics(), "seconds": watch.seconds}
    result.metrics = metrics
    result.outputs |= {
        "calibration": spheres.folder,
        "recording": coin.folder,
        "lights": out / "lights.json",
        "camera": out / "camera.json",
        "overview": out / "overview.png",
        "summary": out / "summary.json",
    }
    result.summary.append(f"look at {out / 'overview.png'}")
    write_record(out / "summary.json", "sgp demo", {"out": out, "seed": seed}, result)
    return result


def _capture(
    folder: Path,
    scene: simulator.Scene,
    rendering: simulator.Rendering,
    seed: int,
    exposures_us: tuple[float, ...],
) -> acquisition.Session:
    plan = acquisition.CapturePlan(leds=tuple(range(len(scene.lights))), exposures_us=exposures_us)
    with simulator.open_rig_seeing(rendering, seed=seed) as rig, Stages() as progress:
        return acquisition.record(
            rig,
            plan,
            folder,
            acquisition.Labels(operator="sgp demo", object_name=folder.name),
            calibrations=acquisition.Calibrations(
                camera_model=simulator.bench_camera(), sensor=scene.noise
            ),
            hooks=acquisition.RecordingHooks(on_progress=progress),
        )


def _calibrate(
    session: acquisition.Session, scene: simulator.Scene
) -> tuple[calibration.SphereCalibration, acquisition.Lights, Float32]:
    """Estimate positions from the spheres, and intensities from the card under them."""
    with Stages() as progress:
        source = acquisition.read_source(session.folder)
        stack = calibration.linear_stack(source, on_progress=progress)
    camera = simulator.bench_camera()
    radii = [sphere.radius_mm for sphere in scene.spheres]
    estimate = calibration.calibrate_spheres(stack, camera=camera, radius_mm=radii)
    estimate = calibration.spheres.record_setup(estimate, source)
    card = calibration.MatteSurface.card(stack.values, camera)
    strong = calibration.calibrate_intensities(card, estimate.lights)
    brightest = np.nan_to_num(np.maximum.reduce(stack.values), nan=1.0)
    return estimate, strong.lights, brightest


class _Errors:
    """Errors of the demo's results."""

    def __init__(
        self, lights: acquisition.Lights, outcome: Outcome, rendering: simulator.Rendering
    ) -> None:
        made = outcome.result.outputs
        truth = rendering.truth
        calibrated = np.asarray(lights.positions_mm)
        true = np.asarray(truth.lights.positions_mm)
        self.light_deg = acquisition.angle_deg(calibrated, true)
        self.light_mm = np.linalg.norm(calibrated - true, axis=1)
        strength, true_strength = (
            intensities.mean(axis=1) / intensities.mean()
            for intensities in map(np.asarray, (lights.intensities, truth.lights.intensities))
        )
        self.light_percent = 100 * np.abs(strength / true_strength - 1)
        normal_map = processing.read_normals(made["normals.normals"].parent).normal_map
        self.normals, self.resolved = (
            processing.angular_error(normal_map, true_normals, truth.mask)
            for true_normals in (truth.normals, simulator.resolved_normals(truth))
        )
        height = acquisition.read_image(made["surface.height"])
        both = truth.mask & np.isfinite(height)
        self.height_map_mm = np.full(truth.mask.shape, np.nan, np.float32)
        difference = height[both] - truth.height_mm[both]
        self.height_map_mm[both] = difference - difference.mean()
        self.height_coverage = float(both.sum() / truth.mask.sum())
        self.height_range_mm = float(np.ptp(truth.height_mm[truth.mask]))
        self.height_mae_mm = float(np.abs(self.height_map_mm[both]).mean())

    def metrics(self) -> ErrorMetrics:
        return {
            "light_error_deg": float(self.light_deg.mean()),
            "light_error_mm": float(self.light_mm.mean()),
            "light_error_percent": float(self.light_percent.mean()),
            "normals_mae_deg": self.normals.mae_deg,
            "normals_resolved_mae_deg": self.resolved.mae_deg,
            "normals_coverage": self.normals.coverage,
            "height_mae_mm": self.height_mae_mm,
            "height_coverage": self.height_coverage,
            "height_relative_error": self.height_mae_mm / self.height_range_mm,
        }

    def table(self) -> list[str]:
        relative = self.height_mae_mm / self.height_range_mm
        covered = f"{self.normals.coverage:.2%} of the object covered"
        rows = (
            ("light direction", self.light_deg, "deg", ""),
            ("light position", self.light_mm, "mm", ""),
            ("light intensity", self.light_percent, "%", ""),
            ("normals", self.normals.map_deg, "deg", covered),
            ("normals, lens blur aside", self.resolved.map_deg, "deg", "truth blurred by the lens"),
            (
                "height, mean removed",
                np.abs(self.height_map_mm),
                "mm",
                f"{relative:.2%} of {self.height_range_mm:.2f} mm",
            ),
        )
        return [
            "",
            f"{'error against the truth':<26}{'mean':>8}{'worst':>9}",
            *(
                f"  {name:<24}{np.nanmean(values):8.3f}{np.nanmax(values):9.3f} {unit:<4} {remark}"
                for name, values, unit, remark in rows
            ),
            "",
        ]
