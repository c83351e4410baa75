"""Build the 3D library of the report from its packages: `sgp/report/vendor/three.js`.

npm and a network are needed here, and only here: the page contains the result.

    python benchmarks/bundle_three.py
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Final

THREE: Final = "three@0.187.0"
ESBUILD: Final = "esbuild@0.28.2"
PLACE: Final = Path(__file__).parents[1] / "sgp" / "report" / "vendor"
USED: Final = """
export {
  AmbientLight, BufferAttribute, BufferGeometry, CanvasTexture, DirectionalLight, DoubleSide, Mesh,
  MeshLambertMaterial, OrthographicCamera, Plane, Raycaster, Scene, SRGBColorSpace, Vector2,
  Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
export { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
export { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "package.json").write_text('{"private": true}')
        (work / "used.js").write_text(USED)
        subprocess.run(["npm", "install", "--silent", THREE, ESBUILD], cwd=work, check=True)
        subprocess.run(
            [
                "node_modules/.bin/esbuild",
                "used.js",
                "--bundle",
                "--minify",
                "--format=iife",
                "--global-name=THREE",
                "--target=es2022",
                "--legal-comments=none",
                f"--banner:js=// {THREE}, bundled by {ESBUILD} (benchmarks/bundle_three.py)",
                f"--outfile={PLACE / 'three.js'}",
            ],
            cwd=work,
            check=True,
        )
        licence = (work / "node_modules" / "three" / "LICENSE").read_text(encoding="utf-8")
    (PLACE / "three.LICENSE").write_text(licence, encoding="utf-8")
    size = (PLACE / "three.js").stat().st_size
    print(f"{THREE}: {size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
