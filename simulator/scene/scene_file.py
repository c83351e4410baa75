"""Read and write scenes as TOML files."""

from __future__ import annotations

import os
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Annotated, Any

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from acquisition import DataError, MissingPathError, NoiseModel, write_durably, write_lights
from rig import MAX_PIXELS, UnreadableError, read_bounded
from rig.files import MAX_TOML_BYTES, parse_toml
from rig.messages import validation_message
from simulator.scene.lamps import Lamps
from simulator.scene.rig_scenes import bench_sensor
from simulator.scene.scene import ChromeSphere, Scene
from simulator.scene.scene_parts import (
    BODIES,
    CLUTTER,
    LENSES,
    LIGHTS,
    MATERIALS,
    PATTERNS,
    RELIEFS,
    build,
    build_kind,
    check_range,
    kind_table,
    lens_table,
    resized,
    table,
)
from simulator.shapes.mesh import MeshBody

Table = dict[str, Any]

_DEFAULTS = {item.name: item.default for item in fields(Scene) if item.default is not MISSING}


class SceneFile(BaseModel):
    """Content of a scene file. Every key except the tables' ``kind`` has a default.

    Parameters
    ----------
    seed
        Seed of all random values whose table has no seed of its own.
    object
        Kind of the object and the parameters of that kind.
    pattern, material
        Albedo and reflectance of the object.
    board
        Albedo of the board.
    relief
        Relief of the board: the kind of an object and its parameters.
    spheres
        Chrome spheres, one table each.
    clutter
        Other balls and boxes, one table each.
    lights, lamps
        Positions and intensities of the LEDs, and their behaviour over time.
    lens, sensor
        Parts of the camera.
    electrons_per_us, board_radius_mm, ambient, surroundings, led_radius_mm
        See `Scene`.
    shadows, soft_shadow_samples
        See `Scene`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    electrons_per_us: float = 0.42
    board_radius_mm: float = _DEFAULTS["board_radius_mm"]
    ambient: float = _DEFAULTS["ambient"]
    surroundings: float = _DEFAULTS["surroundings"]
    led_radius_mm: float = _DEFAULTS["led_radius_mm"]
    shadows: bool = _DEFAULTS["shadows"]
    soft_shadow_samples: int = _DEFAULTS["soft_shadow_samples"]
    object: Table | None = None
    pattern: Table = {"kind": "even", "albedo": 1.0}
    material: Table = {"kind": "lambert"}
    board: Table = {"kind": "even", "albedo": 0.02}
    relief: Table | None = None
    spheres: tuple[Table, ...] = ()
    clutter: tuple[Table, ...] = ()
    lights: Table = {"kind": "dome"}
    lamps: Table = {}
    lens: Table = {"kind": "perspective"}
    sensor: Table = {}

    def build(
        self,
        folder: Path = Path(),
        *,
        leds: int | None = None,
        size: tuple[int, int] | None = None,
        seed: int | None = None,
    ) -> Scene:
        """Build the scene.

        Parameters
        ----------
        folder
            Folder that relative paths start from.
        leds
            Number of LEDs instead of the file's, for a dome or a ring.
        size
            (width, height) in pixels instead of the file's; the width of the field stays.
        seed
            Seed instead of the file's; seeds in tables stay.

        Raises
        ------
        DataError
            If a key is unknown, a value is out of range, a file is missing, or the scene is not
            possible. The message names the table.
        """
        drawn = {"seed": self.seed if seed is None else seed}

        def part(kinds: Any, values: Table, where: str) -> Any:
            return build_kind(kinds, _located(values, folder, where), where, **drawn)

        lights = self.lights
        if leds is not None:
            if lights.get("kind") not in ("dome", "ring"):
                raise DataError("[lights]: the lights are listed one by one: do not give a number")
            lights = lights | {"count": leds}
        check_range(self, "scene")
        lens = part(LENSES, self.lens, "lens")
        lens = lens if size is None else resized(lens, *size)
        height_px, width_px = lens.size
        if height_px * width_px > MAX_PIXELS:
            raise DataError(
                f"[lens]: {width_px} x {height_px} pixels are more than the maximum of {MAX_PIXELS}"
            )
        return Scene(
            **{name: getattr(self, name) for name in _SHARED},
            body=None if self.object is None else part(BODIES, self.object, "object"),
            lights=part(LIGHTS, lights, "lights"),
            lens=lens,
            noise=build(NoiseModel, asdict(bench_sensor()) | self.sensor, "sensor"),
            pattern=part(PATTERNS, self.pattern, "pattern"),
            material=part(MATERIALS, self.material, "material"),
            board=part(PATTERNS, self.board, "board"),
            spheres=tuple(
                build(ChromeSphere, sphere, f"spheres.{index}")
                for index, sphere in enumerate(self.spheres)
            ),
            clutter=tuple(
                build_kind(CLUTTER, item, f"clutter.{index}")
                for index, item in enumerate(self.clutter)
            ),
            relief=None
            if self.relief is None
            else build_kind(
                RELIEFS, self.relief, "relief", **drawn, radius_mm=self.board_radius_mm
            ),
            lamps=build(Lamps, self.lamps, "lamps"),
        )


# Fields that SceneFile and Scene have in common: the numbers at the top of a file.
_SHARED = tuple(
    name
    for name, key in SceneFile.model_fields.items()
    if isinstance(key.default, int | float) and name != "seed"
)


def read_scene(
    path: Path | str,
    *,
    leds: int | None = None,
    size: tuple[int, int] | None = None,
    seed: int | None = None,
) -> Scene:
    """Read a scene file and build its scene.

    Paths in the file are relative to its folder. The parameters are those of `SceneFile.build`.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is not TOML, or `SceneFile.build` raises it. The message names file and key.

    Examples
    --------
    >>> from pathlib import Path
    >>> from simulator import read_scene, scene_named, write_scene
    >>> _ = write_scene("coin.toml", scene_named("coin", width=64, height=52, leds=4))
    >>> read_scene("coin.toml")
    Scene(Coin, 4 lights, 0 spheres, 64 x 52 px)
    """
    path = Path(path)
    try:
        values = parse_toml(read_bounded(path, MAX_TOML_BYTES))
        content = SceneFile.model_validate(values)
        return content.build(path.parent, leds=leds, size=size, seed=seed)
    except FileNotFoundError as error:
        raise MissingPathError(f"{path}: no such file") from error
    except ValidationError as error:
        message = validation_message(error, noun="key", known=SceneFile.model_fields)
        raise DataError(f"{path}: {message}") from error
    except (UnreadableError, DataError) as error:
        raise DataError(f"{path}: {error}") from error


def write_scene(path: Path | str, scene: Scene) -> list[Path]:
    """Write a scene to a file from which `read_scene` builds the same scene.

    The lights are written to a ``.lights.json`` file in the same folder, and a mesh to a ``.ply``
    file.

    Returns
    -------
    list of Path
        Written files.

    Raises
    ------
    DataError
        If scene files have no kind for the scene's object or pattern.
    StorageError
        If a file cannot be written.

    Examples
    --------
    >>> from simulator import scene_named, write_scene
    >>> [path.name for path in write_scene("coin.toml", scene_named("coin", width=64, height=52))]
    ['coin.toml', 'coin.lights.json']
    """
    path = Path(path)
    written = [path, path.with_suffix(".lights.json")]
    body: Table | None = None
    if isinstance(scene.body, MeshBody):
        # Importing trimesh takes longer than opening a rig.
        import trimesh
        from trimesh.exchange.ply import export_ply

        written.append(path.with_suffix(".ply"))
        mesh = trimesh.Trimesh(scene.body.vertices_mm, scene.body.faces, process=False)
        write_durably(written[-1], export_ply(mesh))
        # The mesh is already centred and scaled; reading it again changes nothing.
        place = {"radius_mm": scene.body.radius_mm, "smooth": scene.body.smooth}
        body = {"kind": "mesh", "file": written[-1].name, **place}
    elif scene.body is not None:
        body = kind_table(BODIES, scene.body)
    content = SceneFile(
        **{name: getattr(scene, name) for name in _SHARED},
        object=body,
        pattern=kind_table(PATTERNS, scene.pattern),
        material=kind_table(MATERIALS, scene.material),
        board=kind_table(PATTERNS, scene.board),
        relief=None if scene.relief is None else kind_table(RELIEFS, scene.relief),
        spheres=tuple(table(sphere) for sphere in scene.spheres),
        clutter=tuple(kind_table(CLUTTER, item) for item in scene.clutter),
        lights={"kind": "file", "file": written[1].name},
        lamps=table(scene.lamps),
        lens=lens_table(scene.lens),
        sensor=table(scene.noise),
    )
    write_lights(written[1], scene.lights)
    text = tomli_w.dumps(content.model_dump(exclude_none=True, exclude_defaults=True))
    write_durably(path, text.encode())
    return written


def _located(values: Table, folder: Path, where: str) -> Table:
    """Return a table whose ``file``, if there is one, is resolved against the scene's folder."""
    if not isinstance(values.get("file"), str):
        return values
    file = folder / values["file"]
    # pathlib raises an error if a name is too long.
    if not os.path.isfile(file):
        raise DataError(f"[{where}]: {file}: no such file")
    return values | {"file": file}
