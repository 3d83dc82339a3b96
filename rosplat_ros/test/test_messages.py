"""Batches on the wire: laid out as the message says, whole, and quick."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from std_msgs.msg import Header

from rosplat_core._core import PublishedBatch
from rosplat_core.models import Model
from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.batches import array_bytes
from rosplat_ros.messages import COMPRESSIONS, Slots
from rosplat_testing.messages import decode, encode, encode_deletion

Maker = Callable[..., Splats]


def batch(splats: Splats, slots: Slots) -> GaussianArray:
    return encode(
        splats,
        slots,
        header=Header(frame_id="map"),
        map_id="a",
        revision=7,
        operation=GaussianArray.UPSERT,
        expected_slots=99,
    )


def test_two_gaussians_are_laid_out_as_the_message_says() -> None:
    splats = Splats(
        positions=np.array([[1, 2, 3], [4, 5, 6]]),
        orientations=np.array([[0, 0, 0, 1], [1, 0, 0, 0]]),
        scales=np.array([[0.5, 0.25, 0.125], [1, 2, 4]]),
        opacities=np.array([0.5, 1]),
        # Coefficient k of splat i, channel c: 100 i + 10 k + c.
        sh=np.array([[[100 * i + 10 * k + c for c in range(3)] for k in range(4)] for i in (0, 1)]),
        origin=np.array([1e6, 0, -3]),
        model=Model.RAY,
    )
    message = batch(splats, np.array([8, 3]))
    assert (message.count, list(message.slots)) == (2, [8, 3])
    assert (message.map_id, message.revision, message.expected_slots) == ("a", 7, 99)
    assert (message.sh_degree, message.model, message.origin.x) == (1, Model.RAY, 1e6)
    assert list(message.positions) == [1, 2, 3, 4, 5, 6]
    assert list(message.orientations) == [0, 0, 0, 1, 1, 0, 0, 0]
    assert list(message.scales) == [0.5, 0.25, 0.125, 1, 2, 4]
    assert list(message.opacities) == [0.5, 1]
    assert list(message.sh[:6]) == [0, 1, 2, 10, 11, 12]
    assert list(message.sh[12:15]) == [100, 101, 102]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_channels_lie_one_after_the_other(random_splats: Maker, compression: str) -> None:
    channels = {"label": np.array([1, 2, 3]), "seen": np.array([0.5, np.nan, 0.25])}
    given = replace(random_splats(3), channels=channels)
    message = encode(
        given, range(3), header=Header(), map_id="a", revision=1, operation=GaussianArray.REPLACE,
        compression=compression,
    )  # fmt: skip
    assert message.channel_names == ["label", "seen"]
    np.testing.assert_array_equal(message.channels, [1, 2, 3, 0.5, np.nan, 0.25])
    _, splats = decode(message)
    for name, values in channels.items():
        np.testing.assert_array_equal(splats.channels[name], values)


def test_a_range_of_slots_is_not_spelled_out(random_splats: Maker) -> None:
    message = batch(random_splats(4), range(10, 14))
    assert (message.first_slot, message.count, len(message.slots)) == (10, 4, 0)
    deletion = encode_deletion(range(2, 5), header=Header(), map_id="a", revision=8)
    assert (deletion.operation, deletion.first_slot, deletion.count) == (GaussianArray.DELETE, 2, 3)
    assert not deletion.positions


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("slots", [range(5, 9), np.array([9, 0, 4, 70_000])])
def test_what_is_decoded_is_what_was_encoded(
    random_splats: Maker, degree: int, slots: Slots
) -> None:
    splats = random_splats(4, degree)
    decoded_slots, decoded = decode(batch(splats, slots))
    np.testing.assert_array_equal(decoded_slots, slots)
    for name in ("positions", "orientations", "scales", "opacities", "sh", "origin"):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(splats, name))


def test_a_batch_that_lies_about_its_length_is_refused_by_field(random_splats: Maker) -> None:
    message = batch(random_splats(4), range(4))
    message.scales = message.scales[:-1]
    with pytest.raises(ValueError, match="scales has 11 values, 12 expected"):
        decode(message)
    message = batch(random_splats(4), np.arange(4))
    message.count = 5
    with pytest.raises(ValueError, match="slots has 4 values, count says 5"):
        decode(message)


def test_slots_must_fit_the_splats(random_splats: Maker) -> None:
    with pytest.raises(ValueError, match="3 splats for 4 slots"):
        batch(random_splats(3), range(4))
    with pytest.raises(ValueError, match="contiguous"):
        batch(random_splats(3), range(0, 6, 2))


def compressed(splats: Splats) -> GaussianArray:
    return encode(
        splats,
        range(len(splats)),
        header=Header(),
        map_id="a",
        revision=1,
        operation=GaussianArray.UPSERT,
        compression="quantised",
    )


def test_a_payload_holds_the_splats_in_less(random_splats: Maker) -> None:
    splats = random_splats(200, 3)
    message = compressed(splats)
    assert message.format == "quantised"
    assert not message.positions
    assert array_bytes(message) < splats.nbytes / 3
    _, decoded = decode(message)
    np.testing.assert_allclose(decoded.positions, splats.positions, atol=1e-5)
    np.testing.assert_allclose(decoded.sh[:, 0], splats.sh[:, 0], atol=0.01)
    message.payload = message.payload[:-1]
    with pytest.raises(ValueError, match="payload has"):
        decode(message)


def test_where_a_payload_would_lose_places_arrays_go(random_splats: Maker) -> None:
    splats = random_splats(200, 3)
    splats.positions[7] = 1e9
    message = compressed(splats)
    assert not message.format
    np.testing.assert_array_equal(decode(message)[1].positions, splats.positions)


def test_batches_have_all_fields_of_their_message() -> None:
    converted = {"header", "origin", "groups", "poses"}
    received = {"positions", "orientations", "scales", "opacities", "sh"}
    fields = set(GaussianArray.get_fields_and_field_types())
    assert fields == {*PublishedBatch.FIELDS, *converted, *received}
