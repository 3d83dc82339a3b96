"""Splats for C++: the same from a trainer's arrays as in Python."""

import numpy as np
import pytest

from rosplat_core.splats import Splats
from rosplat_tools import _published_map as cpp


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("axes", [1, 3])
def test_trained_arrays_are_the_same_splats_in_cpp(degree: int, axes: int) -> None:
    rng = np.random.default_rng(degree)
    k = (degree + 1) ** 2
    arrays = [
        rng.normal(size=(7, *shape)).astype(np.float32)
        for shape in ((3,), (4,), (axes,), (1,), (1, 3), (k - 1, 3))
    ]
    cpp_arrays = cpp.Splats.from_trained(*arrays).arrays
    expected = Splats.from_trained(*arrays)
    turned = cpp_arrays["orientations"].reshape(7, 4)
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    np.testing.assert_allclose(turned / lengths, expected.orientations, rtol=1e-5)
    for name in ("positions", "scales", "opacities", "sh"):
        np.testing.assert_allclose(cpp_arrays[name], getattr(expected, name).ravel(), rtol=1e-6)


@pytest.mark.parametrize("name", ["quaternions_wxyz", "log_scales", "logits", "sh0", "shN"])
def test_an_array_of_another_length_is_refused_by_name(name: str) -> None:
    lengths = {"means": 6, "quaternions_wxyz": 8, "log_scales": 6, "logits": 2, "sh0": 6, "shN": 90}
    arrays = {key: np.ones(value + (key == name)) for key, value in lengths.items()}
    with pytest.raises(ValueError, match=rf"^{name}: expected .*, got"):
        cpp.Splats.from_trained(*arrays.values())
