"""Every backend present equals the plain reference, to the bit."""

import contextlib
import importlib.util

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rosplat_core import depth
from rosplat_core.maps import DELETE, MOVE, REPLACE, UPSERT, BatchError
from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.view import SortView
from rosplat_sorter import backends
from rosplat_sorter.backends import (
    AUTO,
    BACKENDS,
    Entry,
    Unavailable,
    choose,
    new_array,
    open_backend,
)
from rosplat_sorter.map import SplatMap
from rosplat_sorter.shared_orders import Memory, OrderBuffer, SharedOrders, memory_of

CANDIDATES = [
    pytest.param(("native", 1, False), id="native-1-thread"),
    pytest.param(("native", 3, False), id="native-3-threads"),
    pytest.param(("numpy", 0, False), id="numpy"),
    pytest.param(("torch", 0, False), id="torch"),
    pytest.param(("torch", 0, True), id="torch-gpu", marks=pytest.mark.gpu),
    pytest.param(("cupy", 0, True), id="cupy", marks=pytest.mark.gpu),
]


@pytest.fixture(params=CANDIDATES)
def backend(request):
    try:
        return open_backend(*request.param)
    except Unavailable as error:
        pytest.skip(f"backend '{request.param[0]}' is not available: {error}")


def cameras(make_camera, random):
    """Views from within and from without, off-centre, of both projections."""
    for orthographic in (False, True):
        for distance in (0.0, 25.0):
            direction = random.normal(size=4)
            yield make_camera(
                position=tuple(random.normal(size=3) * distance),
                orientation=tuple(direction),
                cx=random.uniform(0, 640),
                fx=20.0 if orthographic else 500.0,
                fy=20.0 if orthographic else 450.0,
                near_clip=-20.0 if orthographic else 0.1,
                orthographic=orthographic,
            )


def take(backend, splats, batch):
    splats.apply(batch)
    backend.update(splats, splats.changed_rows)


def assert_equal_to_reference(backend, splats, camera):
    view = SortView.of(camera, splats.frames)
    memory = np.zeros(splats.rows + 1, np.uint32)
    order = backend.order(view, lambda count: memory[1 : count + 1])
    assert order.base is memory
    assert order.dtype == np.uint32
    expected = depth.order(view, splats.positions, splats.extents, *splats.slots_and_groups())
    np.testing.assert_array_equal(order, expected)
    return len(order)


@pytest.mark.parametrize("step", [None, 0.5], ids=["", "ties"])
@pytest.mark.parametrize("origin", [0.0, 1e5])
def test_random_maps(backend, make_camera, make_edit, step, origin):
    random = np.random.default_rng(7)
    count = 200_000
    positions = random.normal(size=(count, 3)) * 8
    if step:
        positions = np.round(positions / step) * step
    splats = SplatMap()
    extents = random.uniform(-0.02, 0.1, count).astype(np.float32)
    splats.apply(make_edit(positions, extents, origin=np.full(3, origin)))
    backend.update(splats, slice(0, splats.rows))
    visible = 0
    for camera in cameras(make_camera, random):
        moved = make_camera(**vars(camera) | {"position": tuple(np.add(camera.position, origin))})
        visible += assert_equal_to_reference(backend, splats, moved)
    assert visible > 1000


def test_depths_of_any_magnitude(backend, make_camera, make_edit):
    random = np.random.default_rng(8)
    count = 50_000
    positions = np.zeros((count, 3))
    positions[:, 2] = 10.0 ** random.uniform(-44, 38, count)
    splats = SplatMap()
    splats.apply(make_edit(positions))
    backend.update(splats, slice(0, splats.rows))
    far = float(np.finfo(np.float32).max)
    for near in (1e-45, 0.1, 1e30):
        camera = make_camera(near_clip=near, far_clip=far)
        assert assert_equal_to_reference(backend, splats, camera) > 1000
    camera = make_camera(near_clip=-far, far_clip=far, orthographic=True)
    assert assert_equal_to_reference(backend, splats, camera) == count


def test_a_map_that_grows(backend, make_camera, make_edit):
    random = np.random.default_rng(9)
    splats = SplatMap()
    camera = make_camera(orthographic=True, fx=20.0, fy=20.0, near_clip=-50.0)
    end = 0
    for revision, size in enumerate((1, 31, 480, 3_584, 4_096, 1, 8_191, 60_000), 1):
        slots = np.arange(end, end + size)
        end += size
        positions = random.normal(size=(size, 3))
        take(backend, splats, make_edit(positions, slots=slots, revision=revision))
        assert assert_equal_to_reference(backend, splats, camera) == end


def test_slots_far_apart_in_pages_that_come_in_any_order(backend, make_camera, make_edit):
    """As authors number them: keyframe << 16 | i. Half of them tie."""
    random = np.random.default_rng(11)
    splats = SplatMap()
    for revision, keyframe in enumerate(random.permutation(200), 1):
        count = int(random.integers(1, 3000))
        edit = make_edit(
            np.round(random.normal(size=(count, 3)) * 4),
            slots=(keyframe << 16) + np.arange(count),
            revision=revision,
        )
        take(backend, splats, edit)
        if revision in (1, 2, 200):
            for camera in cameras(make_camera, random):
                assert_equal_to_reference(backend, splats, camera)
    assert_equal_to_reference(backend, splats, make_camera(orthographic=True, fx=1.0, fy=1.0))
    take(backend, splats, make_edit([[0, 0, 5]], revision=201, operation=REPLACE))
    assert assert_equal_to_reference(backend, splats, make_camera()) == 1


def pose(random):
    return random.normal(size=3) * 5, random.normal(size=4)


@pytest.mark.parametrize("groups", [2, 40])
def test_groups_of_splats_are_in_one_order(backend, make_camera, make_edit, groups):
    """Half of them tie, across groups as well: these lie whole steps apart."""
    random = np.random.default_rng(12)
    splats = SplatMap()
    for revision, page in enumerate(random.permutation(120), 1):
        count = int(random.integers(1, SLOTS_PER_PAGE))
        edit = make_edit(
            np.round(random.normal(size=(count, 3)) * 4),
            slots=page * SLOTS_PER_PAGE + np.arange(count),
            revision=revision,
            group=int(page % groups) * 100,
        )
        take(backend, splats, edit)
    for revision in (121, 122):
        shifts = random.integers(-9, 9, (groups, 3)).astype(float)
        poses = {100 * group: (shift, (0, 0, 0, 1)) for group, shift in enumerate(shifts)}
        if revision == 122:
            poses = {group: pose(random) for group in poses}
        moved = make_edit([], revision=revision, operation=MOVE, poses=poses)
        take(backend, splats, moved)
        for camera in cameras(make_camera, random):
            assert_equal_to_reference(backend, splats, camera)


@pytest.mark.parametrize("far", [1e20, 1e37, 3e38, -1e300, 1.7e308])
def test_a_group_far_beyond_all_hides_no_other(backend, make_camera, make_edit, far):
    random = np.random.default_rng(12)
    splats, without = SplatMap(), SplatMap()
    for group in range(3):
        edit = make_edit(
            random.normal(size=(3000, 3)) * 4,
            slots=SLOTS_PER_PAGE * 4 * group + np.arange(3000),
            revision=group + 1,
            group=group,
        )
        splats.apply(edit)
        if group != 1:
            without.apply(edit)
    away = {1: ((far, -far, far), (0, 0, 0, 1))}
    splats.apply(make_edit([], revision=4, operation=MOVE, poses=away))
    backend.update(splats, slice(0, splats.rows))
    seen = 0
    for camera in cameras(make_camera, random):
        view = SortView.of(camera, without.frames)
        expected = depth.order(
            view, without.positions, without.extents, *without.slots_and_groups()
        )
        assert assert_equal_to_reference(backend, splats, camera) == len(expected)
        seen += len(expected)
    assert seen > 0


def test_orders_in_shared_memory(backend, make_camera, make_edit):
    random = np.random.default_rng(10)
    count = 10_000
    splats = SplatMap()
    splats.apply(make_edit(random.normal(size=(count, 3)) * 8))
    backend.update(splats, slice(0, splats.rows))
    for camera in cameras(make_camera, random):
        view = SortView.of(camera, splats.frames)
        expected = depth.order(view, splats.positions, splats.extents)
        for order in orders_in_shared_memory(backend, view, count):
            np.testing.assert_array_equal(order, expected)


def orders_in_shared_memory(backend, view, capacity):
    """What stands in a file that two orders are written to; the next may come to the same place."""
    memory = Memory(-1, 4096 + 4 * capacity)
    with memory.lent:
        for _ in range(2):
            memory[:] = bytes(len(memory))
            order = backend.order(view, lambda count: np.frombuffer(memory, np.uint32, count, 4096))
            yield np.frombuffer(memory[4096:], np.uint32)[: len(order)]


def test_one_splat_nothing_visible_and_no_map(backend, make_camera, make_edit):
    splats = SplatMap()
    backend.update(splats, slice(0, 0))
    assert assert_equal_to_reference(backend, splats, make_camera()) == 0
    splats.apply(make_edit([[0, 0, 5]]))
    backend.update(splats, slice(0, splats.rows))
    assert assert_equal_to_reference(backend, splats, make_camera()) == 1
    assert assert_equal_to_reference(backend, splats, make_camera(far_clip=1.0)) == 0


def test_torch_without_a_number_of_threads_takes_all_again():
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("with a GPU, threads are none of this backend's business")
    open_backend("torch")
    all_of_them = torch.get_num_threads()
    open_backend("torch", threads=all_of_them + 1)
    assert torch.get_num_threads() == all_of_them + 1
    open_backend("torch", threads=0)
    assert torch.get_num_threads() == all_of_them


@pytest.mark.gpu
def test_memory_that_cupy_pinned_is_unpinned_when_its_segment_goes(make_camera, make_edit):
    try:
        backend = open_backend("cupy")
    except Unavailable as error:
        pytest.skip(f"no CuPy: {error}")
    import cupy

    splats = SplatMap()
    splats.apply(make_edit([[0, 0, 3]]))
    backend.update(splats, slice(0, splats.rows))
    orders = SharedOrders()
    slots = backend.order(SortView.of(make_camera()), OrderBuffer(orders).begin)
    orders.close()
    memory = memory_of(slots)
    address = np.frombuffer(memory, np.uint8).ctypes.data
    cupy.cuda.runtime.hostRegister(address, len(memory), 0)  # refused if it still were
    cupy.cuda.runtime.hostUnregister(address)


def test_zeros_of_both_signs_tie(backend, make_camera, make_edit):
    splats = SplatMap()
    splats.apply(make_edit([[0, 0, z] for z in (0.0, -0.0, 1e-40, 0.0, -1e-40, -0.0)]))
    backend.update(splats, slice(0, splats.rows))
    camera = make_camera(orthographic=True, near_clip=-1.0, far_clip=1.0)
    assert assert_equal_to_reference(backend, splats, camera) == 6


def test_what_overflows_float32_is_not_visible(backend, make_camera, make_edit):
    splats = SplatMap()
    splats.apply(make_edit([[3e38, -3e38, 3e38], [0, 0, 5], [np.inf, np.inf, 1]]))
    backend.update(splats, slice(0, splats.rows))
    camera = make_camera(orientation=(0.1, 0.2, 0.0, 1.0))
    assert assert_equal_to_reference(backend, splats, camera) == 1


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_history_of_edits(backend, make_camera, make_edit, data):
    splats = SplatMap()
    for revision in range(1, data.draw(st.integers(2, 8), "edits")):
        random = np.random.default_rng(data.draw(st.integers(0, 2**32), "seed"))
        count = int(random.integers(1, 40))
        slots = random.choice(int(random.integers(count, 300)), count, replace=False)
        slots = slots * data.draw(st.sampled_from([1, 1, 50, 1 << 16]), "apart")
        operation = data.draw(
            st.sampled_from([REPLACE, UPSERT, UPSERT, UPSERT, DELETE, MOVE]), "operation"
        )
        group = data.draw(st.sampled_from([0, 0, 1, 700]), "group")
        edit = make_edit(
            np.round(random.normal(size=(count, 3)) * 4),
            random.uniform(-0.02, 0.1, count).astype(np.float32),
            slots=None if operation == MOVE else slots,
            poses={group: pose(random)} if operation == MOVE else {},
            map_id=data.draw(st.sampled_from(["a", "a", "a", "b"]), "map"),
            revision=revision,
            operation=operation,
            origin=random.normal(size=3) * 10,
            group=group,
        )
        with contextlib.suppress(BatchError):
            take(backend, splats, edit)
        for camera in cameras(make_camera, random):
            assert_equal_to_reference(backend, splats, camera)


def test_auto_takes_the_best_and_says_why_not_others(monkeypatch):
    monkeypatch.setattr(backends, "_has_nvidia_driver", lambda: False)
    monkeypatch.setattr(importlib.util, "find_spec", {"torch": object()}.get)
    backend, reasons = choose(AUTO, threads=2)
    assert (backend.name, backend.device) == ("native", "2 threads")
    assert reasons == {"cupy": "not installed", "torch": "no NVIDIA driver"}


def test_torch_on_the_cpu_is_taken_only_when_asked_for(monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(backends, "_has_nvidia_driver", lambda: True)
    backend, reasons = choose(AUTO, without=frozenset({"cupy"}))
    assert backend.name != "torch"
    assert reasons["torch"] == "torch finds no GPU"
    assert choose("torch")[0].name == "torch"


def test_a_missing_backend_is_replaced_and_explained(monkeypatch):
    monkeypatch.setitem(BACKENDS, "gone", Entry("gone_backend", "GoneBackend"))
    backend, reasons = choose("gone", without=frozenset({"cupy", "torch"}))
    assert backend.name == "native"
    assert "No module named 'rosplat_sorter.backends.gone_backend'" in reasons["gone"]


def test_a_backend_that_failed_is_not_taken_again():
    backend, _ = choose("native", without=frozenset({"cupy", "torch", "native"}))
    assert backend.name == "numpy"
    with pytest.raises(Unavailable):
        choose(AUTO, without=frozenset(BACKENDS))


def test_native_refuses_arrays_of_another_kind(make_camera):
    from rosplat_core._core import DepthOrder

    view, sorter = SortView.of(make_camera()), DepthOrder(1)
    n = SLOTS_PER_PAGE
    extents, pages = np.zeros(n, np.float32), np.zeros((1, 3), np.uint32)
    for positions in (np.zeros((n, 3)), np.zeros((2 * n, 3), np.float32)[::2]):
        with pytest.raises(TypeError, match="positions"):
            sorter.sort(view, positions, extents, pages, new_array)
    positions = np.zeros((n, 3), np.float32)
    with pytest.raises(ValueError, match="positions"):
        sorter.sort(view, positions[1:], extents, pages, new_array)
    with pytest.raises(TypeError, match="pages"):
        sorter.sort(view, positions, extents, pages.astype(np.int64), new_array)
    for wrong in (
        pages[:0],
        np.zeros((2, 3), np.uint32),
        pages + np.uint32([0, 1, 0]),
        pages + np.uint32([0, 0, 1]),
    ):
        with pytest.raises(ValueError, match="pages"):
            sorter.sort(view, positions, extents, wrong, new_array)
    for wrong in (lambda n: np.zeros(n + 1, np.uint32), lambda n: np.zeros(n), lambda n: None):
        with pytest.raises(TypeError):
            sorter.sort(view, positions, extents, pages, wrong)
    with pytest.raises(MemoryError, match="enough"):
        sorter.sort(view, positions, extents, pages, no_room)


def no_room(count):
    raise MemoryError("enough")


def test_a_backend_of_another_name_is_refused():
    with pytest.raises(ValueError, match="'nope', expected one of cupy, torch, native, numpy"):
        backends.open_backend("nope")
