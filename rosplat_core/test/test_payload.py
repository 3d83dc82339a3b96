"""The payload: how near its splats are to those that went in, and what it takes."""

import numpy as np
import pytest

from rosplat_core import payload
from rosplat_core.payload import Arrays, PayloadError, decode, encode, size


def arrays(count=2000, sh_degree=3):
    random = np.random.default_rng(count)
    orientations = random.normal(size=(count, 4))
    sh = random.normal(size=(count, (sh_degree + 1) ** 2, 3)) * random.lognormal(size=(count, 1, 1))
    return Arrays(
        *(
            values.astype(np.float32)
            for values in (
                random.normal(size=(count, 3)) * 50,
                orientations,
                np.exp(random.uniform(-9, 2, (count, 3))),
                random.uniform(0, 1, count),
                sh,
            )
        )
    )


def all_of(given):
    return np.ones(len(given.positions), bool)


@pytest.mark.parametrize("sh_degree", range(4))
def test_every_value_comes_back_to_within_its_step(sh_degree):
    given = arrays(sh_degree=sh_degree)
    packed = encode(given, all_of(given))
    assert len(packed) == size(2000, sh_degree)
    got = decode(packed, 2000, sh_degree)
    spans = np.ptp(given.positions, axis=0)
    assert (np.abs(got.positions - given.positions) <= spans / 2**24).all()
    np.testing.assert_allclose(got.scales, given.scales, rtol=11 / 2**12)
    np.testing.assert_allclose(got.opacities, given.opacities, rtol=0, atol=1 / 2**10)
    directions = given.orientations / np.linalg.norm(given.orientations, axis=1, keepdims=True)
    along = np.sign((got.orientations * directions).sum(axis=1, keepdims=True))
    assert np.linalg.norm(got.orientations - along * directions, axis=1).max() < 5e-4
    np.testing.assert_allclose(np.linalg.norm(got.orientations, axis=1), 1, atol=1e-6)
    span = np.ptp(np.copysign(np.log1p(np.abs(given.sh[:, 0])), given.sh[:, 0]))
    steps = span / 2**12 * (1 + np.abs(given.sh[:, 0]))
    assert (np.abs(got.sh[:, 0] - given.sh[:, 0]) <= steps).all()
    if sh_degree:
        strongest = np.abs(given.sh[:, 1:]).max(axis=(1, 2), keepdims=True)
        assert (np.abs(got.sh[:, 1:] - given.sh[:, 1:]) <= strongest / 127).all()


def test_sizes():
    assert (size(1000, 0) - size(0, 0)) / 1000 == 24
    assert (size(1000, 3) - size(0, 3)) / 1000 == 70


@pytest.mark.parametrize("format", ["quantised", "packed"])
@pytest.mark.parametrize("sh_degree", [-1, 4, 10])
def test_a_degree_that_no_splat_has_is_refused(sh_degree, format):
    with pytest.raises(PayloadError, match=f"sh_degree is {sh_degree}"):
        decode(np.zeros(4 * 10 * (8 + 11 * 11), np.uint8), 10, sh_degree, format)


def test_what_was_decoded_comes_back_as_it_is():
    given = arrays(500)
    once = decode(encode(given, all_of(given)), 500, 3)
    twice = decode(encode(once, all_of(once)), 500, 3)
    for name in ("positions", "scales", "opacities"):
        np.testing.assert_allclose(getattr(twice, name), getattr(once, name), rtol=2e-4, atol=1e-5)


def test_nothing_one_and_equal_splats():
    assert len(decode(encode(arrays(0), np.ones(0, bool)), 0, 3).positions) == 0
    for count in (1, 7):
        one = arrays(1, 1)
        same = Arrays(*(np.repeat(values, count, axis=0) for values in vars(one).values()))
        got = decode(encode(same, all_of(same)), count, 1)
        np.testing.assert_array_equal(got.positions, same.positions)
        np.testing.assert_allclose(got.sh[:, 0], same.sh[:, 0], rtol=1e-3)


def test_extremes():
    """Zero scales, no harmonics, opacities beyond one, and what means nothing beside them."""
    given = arrays(6, 1)
    given.scales[0] = 0, 1e-30, 0.5
    given.sh[1, 1:] = 0
    given.sh[2] = 3e38, -3e38, 1e-45
    given.opacities[3:5] = 7, -1
    given.positions[5] = np.nan
    given.orientations[4] = 1e-30, 0, -1e30, 0
    before = [values.copy() for values in vars(given).values()]
    usable = np.arange(6) < 5
    got = decode(encode(given, usable), 6, 1)
    for values, kept in zip(vars(given).values(), before, strict=True):
        np.testing.assert_array_equal(values, kept)
    assert got.scales[0, :2].tolist() == [0, 0]
    assert got.scales[0, 2] == pytest.approx(0.5, rel=1e-2)
    assert not got.sh[1, 1:].any()
    assert got.opacities[3:5].tolist() == [1, 0]
    assert np.isnan(got.scales[5]).all()
    assert np.isfinite(got.scales[:5]).all()
    assert abs(got.orientations[4, 2]) == pytest.approx(1, abs=1e-6)


def test_what_is_no_payload_is_refused():
    packed = encode(arrays(10), np.ones(10, bool))
    for wrong in (packed[:-1], np.append(packed, packed[:1]), packed[:0]):
        with pytest.raises(PayloadError, match=r"payload has \d+ bytes, 740 expected"):
            decode(wrong, 10, 3)
    for row, (lower, upper) in enumerate([(np.nan, 1), (0, np.inf), (1, 0), (-np.inf, 0), (2, 1)]):
        bad = packed.copy()
        bad[:40].view(np.float32).reshape(5, 2)[row] = lower, upper
        with pytest.raises(PayloadError, match="bounds"):
            decode(bad, 10, 3)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_few_splats_points_and_none_suit(count):
    given = arrays(count)
    assert payload.suits(given, all_of(given))
    assert payload.suits(given, ~all_of(given))
    given.scales[:] = 0
    assert payload.suits(given, all_of(given))
