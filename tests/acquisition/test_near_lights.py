"""Calibrations of near lights from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from acquisition import CameraModel, DataError, Lights, read_camera, read_lights
from acquisition.value_files import is_near_lights, read_near_lights

DISTANCE = 600.0
CAMERA = CameraModel(np.array([[1000.0, 0, 40], [0, 1000.0, 30], [0, 0, 1]]), 80, 60, DISTANCE)
POINTS = np.array([[0.0, 0, 0], [40, -30, 10], [-25, 50, -5]])
# X right, Y down, Z forward, from the centre of projection: what near_ps means.
S = np.array([[100.0, -50, 20], [-80, 120, -10], [10, 200, 40.0]])
DIR = np.array([[-0.15, 0.1, 1.0], [0.1, -0.2, 1.0], [0.0, -0.3, 1.0]])
DIR /= np.linalg.norm(DIR, axis=1, keepdims=True)
MU = np.array([1.0, 0.5, 2.0])
PHI = np.array([[3.0, 2.0, 1.0], [1.0, 2.0, 3.0], [2.0, 2.0, 2.0]])


def expected_light(point_house: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return N x 3 x 3 light vectors times strengths by the formula of near_ps in its axes."""
    x, y, z = point_house
    point = np.array([x, -y, DISTANCE - z])
    toward = S - point
    distance = np.linalg.norm(toward, axis=1)
    cosine = np.sum(-toward * DIR, axis=1) / distance
    vectors = toward / distance[:, None] * (cosine**MU / distance**2)[:, None]
    vectors = vectors * [1, -1, -1]
    return vectors[:, None, :] * PHI[:, :, None]


def ours(lights: Lights, point: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    assert lights.intensities is not None
    return lights.vectors_at(point)[:, None, :] * lights.intensities[:, :, None]


def write_mat(folder: Path, **values: Any) -> Path:
    path = folder / "light.mat"
    savemat(path, {"S": S, "Dir": DIR, "mu": MU[:, None], "Phi": PHI, **values})
    return path


def write_texts(folder: Path) -> Path:
    for name, values in (("S", S), ("Dir", DIR), ("mu", MU), ("Phi", PHI)):
        np.savetxt(folder / f"{name}.txt", values)
    return folder / "S.txt"


def write_table(folder: Path) -> Path:
    rows = np.column_stack([S, DIR, MU, PHI])
    text = "\n".join(",".join(["led", *map(repr, map(float, row))]) for row in rows)
    (folder / "lights.csv").write_text("name,x,y,z,dx,dy,dz,mu,r,g,b\n" + text)
    return folder / "lights.csv"


@pytest.mark.parametrize("write", [write_mat, write_texts, write_table])
def test_a_calibration_gives_the_light_that_its_own_formula_gives(
    tmp_path: Path, write: Any
) -> None:
    path = write(tmp_path)
    assert is_near_lights(path)
    near = read_near_lights(path, CAMERA)
    scale = ours(near.lights, POINTS[0])[0, 0] / expected_light(POINTS[0])[0, 0]
    for point in POINTS:
        np.testing.assert_allclose(
            ours(near.lights, point), scale[0] * expected_light(point), rtol=1e-9, atol=1e-12
        )
    assert near.lights.intensities is not None
    assert near.lights.intensities.mean() == pytest.approx(1.0)
    assert "3 positions in mm, axes, mu, strengths" in str(near.notice)
    assert "Y down" in near.notice.text
    assert "assumed" in near.notice.text


@pytest.mark.parametrize("axes", ["opengl", "house"])
def test_stated_axes(tmp_path: Path, axes: Any) -> None:
    flip = np.array([1.0, -1.0, -1.0])
    shift = [0.0, 0.0, DISTANCE] if axes == "house" else [0.0, 0.0, 0.0]
    path = write_mat(tmp_path, S=S * flip + shift, Dir=DIR * flip)
    near = read_near_lights(path, CAMERA, axes=axes)
    reference = read_near_lights(write_mat(tmp_path), CAMERA, axes="opencv")
    np.testing.assert_allclose(near.lights.positions_mm, reference.lights.positions_mm)
    np.testing.assert_allclose(near.lights.axes, reference.lights.axes)
    np.testing.assert_allclose(near.lights.intensities, reference.lights.intensities)
    assert "as given" in near.notice.text
    with pytest.raises(DataError, match="of 3 lights shine away from the object in the camera's"):
        read_near_lights(write_mat(tmp_path, S=S * flip + shift, Dir=DIR * flip), CAMERA)


def test_missing_variables_have_defaults(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"S": S, "other": np.zeros((2, 2)), "text": "x"})
    lights = read_near_lights(tmp_path / "a.mat", CAMERA).lights
    assert lights.mu is not None
    assert not lights.mu.any()
    strength = 1 / np.sum((S - [0, 0, DISTANCE]) ** 2, axis=1)
    assert lights.intensities is not None
    np.testing.assert_allclose(lights.intensities[:, 0], strength / strength.mean())


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"S": S[:2]}, "Dir is 3 x 3, but must be 2 x 3 for 2 lights"),
        ({"S": S[:, :2]}, "S is 3 x 2, but must have a row for each light: transpose it"),
        ({"S": S[[0, 1, 2, 2]].T}, "S is 3 x 4, but must have a row for each light: transpose"),
        ({"mu": MU[:2, None]}, "mu is 2 x 1, but must be 3 x 1"),
        ({"Phi": PHI[:, :2]}, "Phi is 3 x 2, but must be 3 x 1 or 3 x 3"),
        ({"Phi": -PHI}, "not a positive number"),
        ({"mu": np.array([[np.nan, 0, 0]])}, "mu of light 0 is not finite"),
        ({"S": np.where(S == 200, np.inf, S)}, "S of light 2 is not finite"),
        ({"Dir": DIR * [[1], [0], [1]]}, "Dir of light 1 has the length 0"),
        ({"S": S / 1000}, "S must be in millimetres"),
        ({"S": S[None, :, :, None]}, "not a matrix"),
    ],
)
def test_invalid_calibrations(tmp_path: Path, values: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_near_lights(write_mat(tmp_path, **values), CAMERA)


def test_vectors_of_matlab_may_be_rows_or_single_numbers(tmp_path: Path) -> None:
    lights = read_near_lights(write_mat(tmp_path, mu=1.0, Phi=PHI[:, :1].T), CAMERA).lights
    columns = read_near_lights(write_mat(tmp_path, mu=np.ones(3), Phi=PHI[:, :1]), CAMERA).lights
    assert lights.mu is not None
    assert lights.mu.tolist() == [1, 1, 1]
    np.testing.assert_array_equal(np.asarray(lights.intensities), np.asarray(columns.intensities))


def test_variables_in_other_case_are_found_and_others_are_named(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"s": S, "directions": DIR, "MU": MU, "pose": 1.0, "who": "x"})
    near = read_near_lights(tmp_path / "a.mat", CAMERA)
    savemat(tmp_path / "b.mat", {"S": S, "Dir": DIR, "mu": MU})
    plain = read_near_lights(tmp_path / "b.mat", CAMERA)
    np.testing.assert_array_equal(np.asarray(near.lights.axes), np.asarray(plain.lights.axes))
    np.testing.assert_array_equal(np.asarray(near.lights.mu), MU)
    assert str(near.notice).endswith("not used: pose, who")
    savemat(tmp_path / "c.mat", {"calib": {"S": S, "Dir": DIR}})
    with pytest.raises(DataError, match="S is missing; it has calib: save the variables"):
        read_near_lights(tmp_path / "c.mat", CAMERA)


def test_files_that_are_no_calibration(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"x": 1.0})
    with pytest.raises(DataError, match="S is missing"):
        read_near_lights(tmp_path / "a.mat", CAMERA)
    (tmp_path / "b.mat").write_bytes(b"no MAT-file")
    with pytest.raises(DataError, match="not a MAT-file"):
        read_near_lights(tmp_path / "b.mat", CAMERA)
    (tmp_path / "c.csv").write_text("x y z mu\n1 2 3 0\n1 2\n")
    with pytest.raises(DataError, match=r"c\.csv line 3: '1 2' does not fit"):
        read_near_lights(tmp_path / "c.csv", CAMERA)
    (tmp_path / "directions.txt").write_text("0 0 1\n")
    assert not is_near_lights(tmp_path / "directions.txt")
    with pytest.raises(DataError, match="need a camera with its working distance"):
        read_near_lights(write_mat(tmp_path), None)
    with pytest.raises(DataError, match="axes that the file does not state"):
        read_lights(write_mat(tmp_path))


def test_a_camera_of_matlab_counts_from_one_and_may_be_transposed(tmp_path: Path) -> None:
    K = CAMERA.K + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    for name, matrix in (("a.mat", K), ("b.mat", K.T)):
        savemat(tmp_path / name, {"K": matrix})
        np.testing.assert_allclose(read_camera(tmp_path / name, (60, 80)).K, CAMERA.K)
    savemat(tmp_path / "c.mat", {"S": S})
    with pytest.raises(DataError, match="no variable K"):
        read_camera(tmp_path / "c.mat", (60, 80))
