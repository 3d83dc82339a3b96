"""Maps in the messages of other packages."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from core_fixtures import random_splats
from geometry_msgs.msg import PoseWithCovarianceStamped
from numpy.typing import NDArray
from point_cloud import cloud

from rosplat_core.splats import SceneError, Splats
from rosplat_tools.following.foreign_messages import from_point_cloud, from_splat_array

ARRAYS = ("positions", "orientations", "scales", "opacities", "sh")


def silent(text: str) -> None:
    raise AssertionError(text)


@pytest.mark.parametrize("how", [{}, {"big_endian": True}, {"height": 5, "gap": 12}])
def test_a_cloud_is_what_the_same_ply_is(how: dict[str, Any]) -> None:
    splats = random_splats(100, 2)
    found = from_point_cloud(cloud(splats, **how), "/cloud", silent)
    for name in ARRAYS:
        np.testing.assert_allclose(
            getattr(found, name), getattr(splats, name), rtol=1e-5, atol=1e-6
        )


def test_further_fields_of_a_cloud_are_channels() -> None:
    splats = replace(random_splats(100), channels={"label": np.arange(100)})
    found = from_point_cloud(cloud(splats), "/cloud", silent)
    np.testing.assert_array_equal(found.channels["label"], np.arange(100))


def test_a_cloud_that_is_no_map_is_named() -> None:
    message = cloud(random_splats(10, 0))
    message.fields = message.fields[:3]
    with pytest.raises(SceneError, match=r"/cloud: .*no property opacity"):
        from_point_cloud(message, "/cloud", silent)
    for name, value, error in [
        ("width", 11, "data: "),
        ("point_step", 8, "point_step: 8 bytes, field z ends after 12"),
        ("point_step", 2**32 - 1, "point_step: 4294967295 bytes"),
        ("height", 3, "data: "),
        ("data", b"", "data: 0 bytes"),
    ]:
        message = cloud(random_splats(10, 0))
        setattr(message, name, value)
        with pytest.raises(SceneError, match=f"/cloud: {error}"):
            from_point_cloud(message, "/cloud", silent)


def covariances(splats: Splats) -> NDArray[np.float64]:
    x, y, z, w = splats.orientations.astype(np.float64).T
    axes = np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        ),
        2,
        0,
    )
    scaled = axes * splats.scales[:, None]
    return scaled @ scaled.transpose(0, 2, 1)


def splat_array(splats: Splats) -> SimpleNamespace:
    """As a gsplat_msgs/SplatArray looks to Python."""
    found = []
    for i, covariance in enumerate(covariances(splats)):
        pose = PoseWithCovarianceStamped()
        position = pose.pose.pose.position
        position.x, position.y, position.z = splats.positions[i].astype(float)
        pose.pose.covariance = np.pad(covariance, (0, 3)).ravel()
        found.append(
            SimpleNamespace(
                pose=pose,
                opacity=round(255 * float(splats.opacities[i])),
                harmonics_deg=splats.sh_degree,
                spherical_harmonics=splats.sh[i].ravel(),
            )
        )
    return SimpleNamespace(splats=found)


def test_a_splat_array_has_the_same_shapes() -> None:
    splats = random_splats(200, 1)
    found = from_splat_array(splat_array(splats), "/splat_array", silent)
    size = np.abs(covariances(splats)).max(axis=(1, 2))
    error = np.abs(covariances(found) - covariances(splats)).max(axis=(1, 2))
    assert (error / size).max() < 1e-5
    np.testing.assert_array_equal(found.sh, splats.sh)
    np.testing.assert_allclose(found.opacities, splats.opacities, atol=0.5 / 255)


def test_a_splat_array_that_contradicts_itself_is_named() -> None:
    message = splat_array(random_splats(3, 1))
    message.splats[1].spherical_harmonics = np.zeros(3)
    with pytest.raises(SceneError, match=r"splats\[1\].spherical_harmonics: 3 numbers"):
        from_splat_array(message, "/splat_array", silent)
    assert len(from_splat_array(splat_array(random_splats(3, 1)[:0]), "/a", silent)) == 0
