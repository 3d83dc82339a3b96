"""Voxels of a map that changes, and the grid that they make."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from rosplat_core.maps import DELETE, MOVE, REPLACE, UPSERT, Arrival, BatchError, batch_of, move_of
from rosplat_core.occupancy import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Grid,
    OccupancyMap,
    depth_of,
    grid_of,
    save_grid,
    towards,
    voxels_across,
)
from rosplat_core.rendering import MAP, insert_all
from rosplat_core.splats import InputError, Splats

PAGE = 1024
RESOLUTION = 0.1
EVERYTHING = 1e-6  # depth
NOBODY = np.zeros(0, np.uint32)


def cloud(count: int, seed: int, spread: float = 1.0) -> Splats:
    """Splats of all shapes, from much thinner to much wider than a voxel."""
    random = np.random.default_rng(seed)
    return Splats(
        positions=random.normal(scale=spread, size=(count, 3)).astype(np.float32),
        orientations=random.normal(size=(count, 4)).astype(np.float32),
        scales=(0.2 * np.exp(random.uniform(-4, 0, (count, 3)))).astype(np.float32),
        opacities=random.uniform(0, 1, count).astype(np.float32),
        sh=random.normal(scale=0.5, size=(count, 4, 3)).astype(np.float32),
    )


class Author:
    """Sends batches to a map."""

    def __init__(self, target: OccupancyMap) -> None:
        self.target, self.revision = target, 0

    def send(
        self, operation: int, slots: NDArray[np.uint32] = NOBODY, splats: Splats | None = None,
        group: int = 0, poses: dict[int, list[float]] | None = None,
        arrival: Arrival = Arrival.HEARD,
    ) -> None:  # fmt: skip
        self.revision += 1
        some = cloud(0, 0) if splats is None else splats
        named = {"map_id": MAP, "revision": self.revision, "group": group}
        batch = batch_of(some, operation=operation, count=len(slots), slots=slots, **named)
        self.target.apply(move_of(poses, **named) if poses else batch, arrival)


def same(one: OccupancyMap, other: OccupancyMap) -> bool:
    pairs = zip(one.find(EVERYTHING), other.find(EVERYTHING), strict=True)
    ours, theirs = one.surface(EVERYTHING), other.surface(EVERYTHING)
    return (
        one.voxels == other.voxels
        and all(np.array_equal(a, b) for a, b in pairs)
        and all(np.array_equal(ours[name], theirs[name]) for name in ours)
        and (one.too_large, one.beyond) == (other.too_large, other.beyond)
    )


def test_a_map_after_many_edits_is_that_which_is_built_at_once() -> None:
    """Written, overwritten, emptied and moved, at another number of threads; to the bit."""
    random = np.random.default_rng(3)
    edited = Author(OccupancyMap(RESOLUTION, 64, threads=2))
    edited.send(REPLACE)
    held: dict[int, tuple[int, Splats]] = {}  # by slot: group, one splat
    poses: dict[int, list[float]] = {}
    for step in range(60):
        group = int(random.integers(3))
        slots = (2 * PAGE * group + random.choice(2 * PAGE, 50, replace=False)).astype(np.uint32)
        if step % 5 == 3:
            edited.send(DELETE, slots)
            for slot in slots.tolist():
                held.pop(slot, None)
        elif step % 5 == 4:
            orientation = random.normal(size=4)
            poses[group] = [*random.normal(scale=0.3, size=3), *orientation]
            edited.send(MOVE, poses={group: poses[group]})
        else:
            splats = cloud(len(slots), step)
            edited.send(UPSERT, slots, splats, group)
            held |= {slot: (group, splats[[i]]) for i, slot in enumerate(slots.tolist())}
    fresh = Author(OccupancyMap(RESOLUTION, 64, threads=1))
    fresh.send(REPLACE)
    for slot, (group, splat) in held.items():
        fresh.send(UPSERT, np.array([slot], np.uint32), splat, group)
    assert not same(edited.target, fresh.target)  # where the groups aren't placed
    fresh.send(MOVE, poses=poses)
    assert fresh.target.voxels > 1000
    assert fresh.target.beyond > 0
    assert same(edited.target, fresh.target)


def test_a_block_of_another_group_and_a_slot_named_twice_leave_no_voxels() -> None:
    first, again = np.arange(3, dtype=np.uint32), np.array([5, 5], np.uint32)
    some = cloud(3, 1)
    regrouped, twice = (Author(OccupancyMap(RESOLUTION, 64)) for _ in range(2))
    regrouped.send(UPSERT, first, some)
    regrouped.send(UPSERT, first[:1], some[:1], group=1, arrival=Arrival.PULLED)
    twice.send(UPSERT, again, some[:2])
    for author, slots, splats in (regrouped, first[:1], some[:1]), (twice, again[:1], some[1:2]):
        fresh = Author(OccupancyMap(RESOLUTION, 64))
        fresh.send(UPSERT, slots, splats)
        assert same(author.target, fresh.target)
        author.send(DELETE, slots)
        assert author.target.voxels == 0


def test_of_a_map_that_is_emptied_nothing_is_left() -> None:
    for operation in (DELETE, REPLACE):
        author = Author(OccupancyMap(RESOLUTION, 64))
        slots = np.arange(500, dtype=np.uint32)
        author.send(REPLACE, slots, cloud(500, 1, 3.0))
        assert author.target.voxels
        assert author.target.beyond
        author.send(operation, slots if operation == DELETE else NOBODY)
        assert (author.target.voxels, author.target.beyond) == (0, 0)
        assert len(author.target.find(0.0)[0]) == 0


def test_a_map_that_is_elsewhere_has_the_voxels_of_there() -> None:
    splats = cloud(500, 2)
    quarter = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]  # about z
    turn = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, 0.2], [0, 0, 1, -0.4], [0, 0, 0, 1]])
    placed, moved = (OccupancyMap(RESOLUTION, 128) for _ in range(2))
    insert_all(placed, splats)
    placed.place([0.5, 0.2, -0.4], quarter)
    insert_all(moved, splats.moved(turn))
    (cells, depths), (expected, theirs) = placed.find(0.2), moved.find(0.2)
    found = {tuple(cell): depth for cell, depth in zip(cells.tolist(), depths, strict=True)}
    both = [found[tuple(cell)] for cell in expected.tolist() if tuple(cell) in found]
    assert len(both) > 0.99 * len(expected)  # positions of float32 fall to either side
    assert abs(np.sum(both) / theirs.sum() - 1) < 0.01


def test_splats_that_are_too_large_or_beyond_are_counted_and_left_out() -> None:
    splats = cloud(3, 4, 0.1)
    splats.scales[0] = 50.0
    splats.positions[1] = (100.0, 0, 0)
    splats.opacities[:] = 0.9
    voxels = OccupancyMap(RESOLUTION, 64)
    insert_all(voxels, splats)
    assert (voxels.too_large, voxels.beyond) == (1, 1)
    alone = OccupancyMap(RESOLUTION, 64)
    insert_all(alone, splats[[2]])
    assert np.array_equal(voxels.find(EVERYTHING)[1], alone.find(EVERYTHING)[1])


def test_of_more_voxels_than_are_held_there_are_none() -> None:
    """Until the map begins anew."""
    author = Author(OccupancyMap(RESOLUTION, 64, most=300))
    voxels, slots = author.target, np.arange(500, dtype=np.uint32)
    author.send(REPLACE, slots, cloud(500, 5))
    for _ in range(2):
        assert (voxels.full, voxels.most, voxels.voxels, voxels.splats) == (True, 300, 0, 500)
        assert not len(voxels.find(0.0)[0])
        author.send(UPSERT, slots[:3], cloud(3, 6))
    author.send(REPLACE, slots[:3], cloud(3, 6, 0.1))
    alone = OccupancyMap(RESOLUTION, 64)
    insert_all(alone, cloud(3, 6, 0.1))
    assert not voxels.full
    assert same(voxels, alone)


def test_a_closed_surface_takes_away_light_however_thin_it_is() -> None:
    """A wall of 2 x 2 m across x, of splats that just close it, and one of every second splat."""
    spacing = 0.04
    y, z = np.meshgrid(*[np.arange(-1, 1, spacing)] * 2)
    for thickness in (1e-5, 1e-2):
        wall = Splats(
            positions=np.column_stack([np.full(y.size, 0.05), y.ravel(), z.ravel()]),
            orientations=np.tile([0.0, 0, 0, 1], (y.size, 1)),
            scales=np.tile([thickness, 0.6 * spacing, 0.6 * spacing], (y.size, 1)),
            opacities=np.full(y.size, 0.9),
            sh=np.zeros((y.size, 1, 3)),
        )
        voxels = OccupancyMap(RESOLUTION, 64)
        insert_all(voxels, wall)
        cells, depths = voxels.find(depth_of(0.5))
        assert set(cells[:, 0].tolist()) == {0}
        assert len(cells) >= 20 * 20
        inner = (np.abs(cells[:, 1:] + 0.5) < 9).all(axis=1)
        # All that a voxel's face is covered by: the splats' alphas, each integrated.
        covered = 2 * np.pi * 0.9 * 0.6**2
        np.testing.assert_allclose(depths[inner, 0], covered, rtol=0.35)
        assert abs(depths[inner, 0].mean() / covered - 1) < 0.01
        surface = voxels.surface(depth_of(0.5))
        np.testing.assert_allclose(np.abs(surface["normals"]), [[1, 0, 0]] * len(cells), atol=0.02)
        np.testing.assert_allclose(surface["positions"][:, 0], 0.05, atol=0.01)
        np.testing.assert_allclose(surface["colors"], 0.5, atol=1e-3)
    normals = towards(surface["positions"], surface["normals"], np.array([-3.0, 0, 0]))
    assert (normals[:, 0] < -0.9).all()


def test_a_batch_that_contradicts_itself_leaves_the_voxels_as_they_are() -> None:
    author = Author(OccupancyMap(RESOLUTION, 64))
    author.send(REPLACE, np.arange(100, dtype=np.uint32), cloud(100, 5))
    before = author.target.find(EVERYTHING)
    with pytest.raises(BatchError, match="positions"):
        author.send(UPSERT, np.arange(50, dtype=np.uint32), cloud(49, 6))
    broken = cloud(50, 6)
    broken.positions[:] = np.nan  # left out: their slots are emptied
    author.send(UPSERT, np.arange(50, dtype=np.uint32), broken)
    kept = Author(OccupancyMap(RESOLUTION, 64))
    kept.send(REPLACE, np.arange(100, dtype=np.uint32), cloud(100, 5))
    kept.send(DELETE, np.arange(50, dtype=np.uint32))
    assert len(before[0]) > len(author.target.find(EVERYTHING)[0])
    assert same(author.target, kept.target)


def room() -> NDArray[np.int32]:
    """A floor of 20 x 20 cells between walls, a table, a ceiling, and a floor out of reach."""
    x, y = (axis.ravel() for axis in np.mgrid[0:20, 0:20])
    floor = np.column_stack([x, y, 0 * x])
    walls = [
        (i, j, k) for i in range(20) for j in range(20) for k in range(1, 25)
        if i in (0, 19) or j in (0, 19)
    ]  # fmt: skip
    table = [(i, j, 7) for i in (8, 9) for j in (4, 5, 6)]
    ceiling = np.column_stack([x, y, 0 * x + 25])
    outside = [(i, j, 0) for i in (30, 31) for j in range(20)]
    return np.concatenate([floor, walls, table, ceiling, outside]).astype(np.int32)


def test_a_grid_knows_what_is_occupied_what_is_free_and_what_is_neither() -> None:
    grid = grid_of(room(), 0.1, (0.1, 1.8), 0.0, (0.55, 0.55))
    assert grid.cells.shape == (20, 32)
    assert grid.origin == (0.0, 0.0)
    expected = np.full((20, 32), UNKNOWN)
    expected[:, :20] = OCCUPIED
    expected[1:19, 1:19] = FREE
    expected[4:7, 8:10] = OCCUPIED
    assert np.array_equal(grid.cells, expected)  # nobody came to what is outside


@pytest.mark.parametrize(
    ("band", "level", "table"), [((0.1, 0.6), 0.0, False), ((0.1, 0.6), 0.3, True)]
)
def test_a_band_follows_its_level(band: tuple[float, float], level: float, table: bool) -> None:
    grid = grid_of(room(), 0.1, band, level, (0.55, 0.55))
    assert (grid.cells[5, 8] == OCCUPIED) == table


@pytest.mark.parametrize("start", [(-5.0, 0.5), (2.5, 0.5), (1e9, 0.0)])
def test_without_a_floor_at_the_start_nothing_is_free(start: tuple[float, float]) -> None:
    grid = grid_of(room(), 0.1, (0.1, 1.8), 0.0, start)
    assert FREE not in grid.cells
    assert OCCUPIED in grid.cells


def test_a_hole_in_the_floor_at_the_start_does_no_harm() -> None:
    cells = room()
    holes = (cells[:, 2] == 0) & (np.abs(cells[:, :2] - [5, 5]).max(axis=1) <= 1)
    whole = grid_of(cells, 0.1, (0.1, 1.8), 0.0, (0.55, 0.55))
    grid = grid_of(cells[~holes], 0.1, (0.1, 1.8), 0.0, (0.55, 0.55))
    assert (whole.cells == FREE).sum() - (grid.cells == FREE).sum() == 9


def test_without_anything_in_the_band_all_is_unknown() -> None:
    for cells in (room()[:0], room() + np.array([0, 0, 100], np.int32)):
        grid = grid_of(cells, 0.1, (0.1, 1.8), 0.0, (0.55, -0.55))
        assert grid.cells.tolist() == [[UNKNOWN]]
        np.testing.assert_allclose(grid.origin, (0.5, -0.6))


def test_a_grid_is_written_as_map_server_reads_it(tmp_path: Path) -> None:
    cells = np.array([[UNKNOWN, FREE, OCCUPIED], [FREE, FREE, UNKNOWN]], np.int8)
    save_grid(tmp_path / "flat.yaml", Grid(cells, (-1.5, 2.25), 0.05))
    text = (tmp_path / "flat.yaml").read_text()
    values = dict(line.split(": ") for line in text.splitlines())
    assert values["image"] == '"flat.pgm"'
    assert (values["resolution"], values["origin"]) == ("0.05", "[-1.5, 2.25, 0]")
    header, pixels = re.fullmatch(
        rb"P5\n(3 2)\n255\n(.{6})", (tmp_path / "flat.pgm").read_bytes(), re.DOTALL
    ).groups()  # type: ignore[union-attr]
    assert header == b"3 2"
    # As map_server reads them: dark is occupied, and the picture's first row is the highest y.
    shades = (255 - np.frombuffer(pixels, np.uint8).reshape(2, 3)[::-1].astype(float)) / 255
    read = np.full(shades.shape, UNKNOWN)
    read[shades > float(values["occupied_thresh"])] = OCCUPIED
    read[shades < float(values["free_thresh"])] = FREE
    assert np.array_equal(read, cells)
    with pytest.raises(InputError, match=re.escape("flat.pgm: expected a name that ends in .yaml")):
        save_grid(tmp_path / "flat.pgm", Grid(cells, (0.0, 0.0), 0.05))


def test_an_odd_name_of_a_grid_is_read_back(tmp_path: Path) -> None:
    for name in ("floor #2", "a: b", "{x}"):
        save_grid(tmp_path / f"{name}.yaml", Grid(np.zeros((1, 1), np.int8), (0.0, 0.0), 0.05))
        values = yaml.safe_load((tmp_path / f"{name}.yaml").read_text())
        assert (tmp_path / values["image"]).is_file()


def test_a_cube_of_too_many_voxels_is_refused() -> None:
    assert voxels_across(1.0, 0.3) == 4
    with pytest.raises(InputError, match=r"size 1000 m at resolution .* 20,000 voxels"):
        voxels_across(1000.0, 0.05)
    with pytest.raises(ValueError, match="voxels of more than 0 m"):
        OccupancyMap(0.0, 64)
