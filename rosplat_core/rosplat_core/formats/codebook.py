"""Codebooks: few values, or few vectors, that stand for many with little squared error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.decoded import Floats, blocks

SAMPLE = 1 << 20  # values that a codebook is made from, at most
VECTORS = 64  # sampled for each centre that k-means finds
LEAF = 512  # centres that k-means finds at a time; for more, it first makes groups
GROUPS = 64  # of vectors, which are then handled one by one
ROUNDS = 8
SIZE = 256  # of a codebook: SOG has bytes
MOST_OCTAVES = 58  # of a vector's numbers, so that float32 holds the sum of their squares
# Multiplications of a matrix product that OpenBLAS leaves to one thread: waking others takes longer
# than the many small products here.
SMALL_PRODUCT = 1 << 18

_Labels = NDArray[np.intp]


def codebook(values: Floats) -> NDArray[np.float32]:
    """(256,) ascending values for any number of values, by Lloyd's iteration (1982)."""
    flat = values.reshape(-1)
    if not len(flat):
        return np.zeros(SIZE, np.float32)
    sample = np.sort(flat[:: -(-len(flat) // SAMPLE)]).astype(np.float64)
    if sample[0] == sample[-1]:  # a histogram of a large number alone has no width
        return np.full(SIZE, sample[0], np.float32)
    # A few values are best spread by the cube root of the density (Panter and Dite 1951).
    counts, edges = np.histogram(sample, SIZE)
    shares = np.concatenate([[0], np.cumsum(np.cbrt(counts))])
    book: NDArray[np.float64] = np.interp(
        (np.arange(SIZE) + 0.5) / SIZE * shares[-1], shares, edges
    )
    sums = np.concatenate([[0], np.cumsum(sample)])
    for _ in range(ROUNDS):
        book[[0, -1]] = flat.min(), flat.max()
        ends = np.searchsorted(sample, (book[1:] + book[:-1]) / 2)
        bounds = np.concatenate([[0], ends, [len(sample)]])
        members = np.diff(bounds)
        means = np.diff(sums[bounds]) / np.maximum(members, 1)
        book[1:-1] = np.where(members > 0, means, book)[1:-1]
        book.sort()
    return book.astype(np.float32)


def nearest(values: Floats, book: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Index of the value, in an ascending codebook of 256, that is nearest to each of values."""
    return np.searchsorted(book[1:] / 2 + book[:-1] / 2, values).astype(np.uint8)


def palette(vectors: NDArray[np.float32], size: int) -> tuple[NDArray[np.float32], _Labels]:
    """Up to size vectors (m, d) that stand for vectors (n, d), n > 0, and the index (n,) for each.

    k-means of groups of groups: a little worse than k-means of all, and far faster.
    """
    # In a unit in which float32 holds sums of squares.
    _, octaves = np.frexp(np.abs(vectors).max())
    unit = np.float32(2.0 ** max(0, int(octaves) - MOST_OCTAVES))
    vectors = vectors / unit
    rng = np.random.default_rng(0)
    labels = np.zeros(len(vectors), np.intp)
    books: list[NDArray[np.float32]] = []
    found = 0
    waiting = [(np.arange(len(vectors)), size)]
    while waiting:
        own, share = waiting.pop()
        part = vectors[own]
        centres = _k_means(part, share if share <= LEAF else GROUPS, rng)
        label = _nearest_vector(part, centres)
        members = [own[label == i] for i in range(len(centres))]
        if share <= len(centres) or max(len(group) for group in members) == len(own):
            labels[own] = found + label
            books.append(centres)
            found += len(centres)
            continue
        errors = np.bincount(label, ((part - centres[label]) ** 2).sum(axis=1), len(centres))
        shares = 1 + (share - len(centres)) * errors / max(errors.sum(), 1e-30)
        waiting += [
            (group, min(int(part_share), len(group)))
            for group, part_share in zip(members, shares, strict=True)
            if len(group)
        ]
    return np.concatenate(books) * unit, labels


def _k_means(
    vectors: NDArray[np.float32], count: int, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Up to count centres of (n, d) vectors."""
    if len(vectors) > VECTORS * count:
        vectors = vectors[rng.choice(len(vectors), VECTORS * count, replace=False)]
    if len(vectors) <= count:
        return vectors
    centres = vectors[rng.choice(len(vectors), count, replace=False)]
    for _ in range(ROUNDS):
        labels = _nearest_vector(vectors, centres)
        order = np.argsort(labels, kind="stable")
        members = np.bincount(labels, minlength=count)
        used = members > 0
        starts = (np.cumsum(members) - members)[used]
        sums = np.add.reduceat(vectors[order], starts, axis=0)
        centres[used] = sums / members[used, None]
    return centres


def _nearest_vector(vectors: NDArray[np.float32], centres: NDArray[np.float32]) -> _Labels:
    labels = np.empty(len(vectors), np.intp)
    squares, doubled = (centres**2).sum(axis=1), 2 * centres.T
    rows = max(1, SMALL_PRODUCT // centres.size)
    for part in blocks(len(vectors)):
        block = vectors[part]
        whole = len(block) // rows * rows
        products = np.empty((len(block), len(centres)), np.float32)
        stacked = block[:whole].reshape(whole // rows, rows, block.shape[1])
        products[:whole] = (stacked @ doubled).reshape(whole, len(centres))
        products[whole:] = block[whole:] @ doubled
        labels[part] = (squares - products).argmin(axis=1)
    return labels
