"""Calibrations: files, messages, lenses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo

from rosplat_core.lenses import Lens, LensError
from rosplat_core.splats import InputError
from rosplat_tools.cameras.calibrations import lens_of, load, of_lens, rectified

FILE = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [430.2, 0, 306.7, 0, 431.0, 227.2, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.34, 0.12, 0.0008, -0.0003, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [400.5, 0, 310.1, 0, 0, 401.5, 220.2, 0, 0, 0, 1, 0]
"""


def write(folder: Path, text: str) -> str:
    path = folder / "camera.yaml"
    path.write_text(text)
    return str(path)


def test_a_file_of_camera_calibration_is_read(tmp_path: Path) -> None:
    info = load(write(tmp_path, FILE))
    lens = lens_of(info)
    assert (lens.width, lens.height, lens.fx, lens.cy) == (640, 480, 430.2, 227.2)
    assert lens.model == "plumb_bob"
    assert lens.coefficients == (-0.34, 0.12, 0.0008, -0.0003, 0.0)
    straight, rotation = rectified(info)
    assert (straight.fx, straight.fy, straight.cx, straight.cy) == (400.5, 401.5, 310.1, 220.2)
    assert straight.is_pinhole
    np.testing.assert_array_equal(rotation, np.eye(3))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("image_width: 640", "image_width: wide", "image_width is 'wide', expected a whole number"),
        ("plumb_bob", "magic", "distortion_model is 'magic', known are plumb_bob, rational_poly"),
        ("[430.2, 0, ", "[430.2, ", "camera_matrix: 8 numbers, expected 9"),
        ("430.2", "-1", "k: focal lengths are -1.0, 431.0"),
        ("camera_matrix:", "camera_matrix: 3\nx:", "camera_matrix: no data, or not of numbers"),
        ("430.2", "9" * 400, "camera_matrix: a number beyond 64 bits"),
        (FILE, "[1, 2", "no YAML: "),
        (FILE, "9" * 5000, "no YAML: "),
        (FILE, "7", "expected keys and values"),
    ],
)
def test_a_file_that_is_none_names_itself_and_the_key(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    path = write(tmp_path, FILE.replace(old, new))
    with pytest.raises(InputError) as error:
        load(path)
    assert str(error.value).startswith(f"{path}: {said}")
    assert "\n" not in str(error.value)


def test_a_lens_comes_back_from_its_message() -> None:
    lens = Lens(320, 240, 200.0, 201.0, 150.0, 110.0, "equidistant", (0.1, 0.02, 0.0, 0.0))
    back = lens_of(of_lens(lens))
    assert {**vars(back)} == {**vars(lens)}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"binning_x": 2}, "binning is 2 x 0, expected none"),
        ({"width": 0}, "width is 0"),
        ({"d": [float("nan")] * 5}, "a number is not finite"),
    ],
)
def test_a_message_that_is_none_names_the_field(change: dict[str, object], said: str) -> None:
    info = of_lens(Lens(320, 240, 200.0, 200.0, 160.0, 120.0))
    for field, value in change.items():
        setattr(info, field, value)
    with pytest.raises(LensError, match=said):
        lens_of(info)


def test_a_part_of_the_picture_is_refused() -> None:
    info = of_lens(Lens(320, 240, 200.0, 200.0, 160.0, 120.0))
    info.roi.width, info.roi.height = 100, 100
    with pytest.raises(LensError, match="roi is 100 x 100, expected the whole picture"):
        lens_of(info)


def test_a_message_of_zeros_rectifies_nothing() -> None:
    with pytest.raises(LensError, match="not calibrated"):
        rectified(CameraInfo(width=3, height=2))


def test_zeros_in_place_of_a_rotation_turn_nothing() -> None:
    info = of_lens(Lens(320, 240, 200.0, 200.0, 160.0, 120.0))
    info.r = [0.0] * 9
    np.testing.assert_array_equal(rectified(info)[1], np.eye(3))
    info.r = [2.0, *[0.0] * 8]
    with pytest.raises(LensError, match="r: expected a rotation"):
        rectified(info)


def test_a_file_without_a_model_is_plumb_bob(tmp_path: Path) -> None:
    """As ROS's own parser has it; older files call it camera_model."""
    path = write(tmp_path, FILE.replace("distortion_model", "camera_model"))
    assert lens_of(load(path)).model == "plumb_bob"


F_THETA = """{"resolution": [960, 540], "shutter_type": "GLOBAL", "principal_point": [477.9, 271.4],
"reference_poly": "ANGLE_TO_PIXELDIST", "angle_to_pixeldist_poly": [0, 474, -9.5, 25, -42, 15],
"pixeldist_to_angle_poly": [0, 0.0021, 1e-7, -8e-10, 2.5e-12, -1.8e-15], "max_angle": 1.35,
"linear_cde": [0.99975, 6e-5, -1e-4]}"""


def test_parameters_of_an_f_theta_camera_are_read(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(F_THETA)
    lens = lens_of(load(str(path)))
    assert (lens.width, lens.height, lens.cx, lens.cy) == (960, 540, 477.9, 271.4)
    angle = 1.2
    distance = np.polynomial.polynomial.polyval(angle, [0, 474, -9.5, 25, -42, 15])
    across, down = np.sin(angle) * np.eye(2)
    rays = np.array([[*across, np.cos(angle)], [*down, np.cos(angle)]])
    expected = [[477.9 + 0.99975 * distance, 271.4], [477.9, 271.4 + distance]]
    np.testing.assert_allclose(lens.project(rays), expected, atol=1e-9)
    assert not np.isfinite(lens.project([np.sin(1.4), 0, np.cos(1.4)])).any()
    path.write_text(F_THETA.replace("ANGLE_TO_PIXELDIST", "PIXELDIST_TO_ANGLE"))
    ray = lens_of(load(str(path))).rays([477.9, 271.4 + 300])
    back = np.polynomial.polynomial.polyval(300, [0, 0.0021, 1e-7, -8e-10, 2.5e-12, -1.8e-15])
    assert np.arctan2(ray[1], ray[2]) == pytest.approx(back, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"resolution": [960, 540]', '"resolution": 960', "resolution: no data, or not of numbers"),
        ("[960, 540]", "[Infinity, 540]", "resolution is 'inf', expected a whole number of pixels"),
        ("[960, 540]", "[NaN, 540]", "resolution is 'nan', expected a whole number of pixels"),
        ("[0, 474,", "[0, -474,", "angle_to_pixeldist_poly rises by -474.0, expected more than 0"),
        (
            "[0, 474,",
            "[0, 4e99,",
            "angle_to_pixeldist_poly rises by 4e.99, expected more than 0, less",
        ),
        ("6e-5", "0.1", "linear_cde is 0.99975, 0.1, -0.0001: a skewed picture"),
        ("ANGLE_TO_PIXELDIST", "BOTH", "reference_poly is 'BOTH', expected ANGLE_TO_PIXELDIST or"),
        ("1.35", '"wide"', "max_angle: no data, or not of numbers"),
        ("}", "", "no JSON"),
    ],
)
def test_what_is_wrong_with_an_f_theta_camera_names_the_key(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(F_THETA.replace(old, new))
    with pytest.raises(InputError, match=said):
        load(str(path))
