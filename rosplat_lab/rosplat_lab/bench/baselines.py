"""Other ways to sort, to hold ours against: what viewers of splats commonly do, and bare CUB.

None of them culls. Each is made for positions, float32 (n, 3), and raises ImportError or
RuntimeError where it can't run; called with a SortView it returns the slots, farthest first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import depth
from rosplat_core.view import SortView

Positions = NDArray[np.float32]
Sort = Callable[[SortView], Any]


def _opengl(view: SortView) -> tuple[Positions, Positions]:
    """Rotation and translation into a camera that looks along -z: what is farthest has least z."""
    flip = np.array([1, -1, -1], np.float32)
    return flip[:, None] * view.rotations[0], flip * view.translations[0]


def _torch() -> Any:
    import torch

    if not torch.cuda.is_available():
        raise RuntimeError("torch finds no GPU")
    return torch


def argsort(positions: Positions) -> Sort:
    """Depths by a batch of 3x3 products, then np.argsort: shadygm/ROSplat's CPUSorter."""

    def sort(view: SortView) -> NDArray[np.int32]:
        rotation, translation = _opengl(view)
        seen = rotation[None] @ positions[..., None] + translation[None, :, None]
        return np.argsort(seen[:, 2, 0]).astype(np.int32).reshape(-1, 1)

    return sort


def depth_argsort(positions: Positions) -> Sort:
    """np.argsort of depths alone, without what comes before and after."""
    return lambda view: np.argsort(-depth.transform(view, positions, 2))


def torch_uploading(positions: Positions) -> Sort:
    """All positions sent to the GPU for each sort, the order back through pageable memory.

    As shadygm/ROSplat's TorchSorter, whose renderer always asks for a forced update.
    """
    torch = _torch()

    def sort(view: SortView) -> NDArray[np.int32]:
        on_device = torch.tensor(positions, device="cuda")
        rotation, translation = (torch.tensor(part, device="cuda") for part in _opengl(view))
        seen = rotation[None] @ on_device[..., None] + translation[None, :, None]
        order = torch.argsort(seen[:, 2, 0]).type(torch.int32).reshape(-1, 1)
        result: NDArray[np.int32] = order.cpu().numpy()
        return result

    return sort


def cupy_uploading(positions: Positions) -> Sort:
    """The same with CuPy: shadygm/ROSplat's CupySorter."""
    import cupy

    cupy.cuda.Device().compute_capability  # noqa: B018  raises where there is none

    def sort(view: SortView) -> NDArray[np.int32]:
        on_device = cupy.asarray(positions)
        rotation, translation = (cupy.asarray(part) for part in _opengl(view))
        seen = rotation[None] @ on_device[..., None] + translation[None, :, None]
        order = cupy.argsort(seen[:, 2, 0]).astype(cupy.int32).reshape(-1, 1)
        result: NDArray[np.int32] = cupy.asnumpy(order)
        return result

    return sort


def torch_on_device(positions: Positions) -> Sort:
    """torch.argsort of depths that are on the GPU already; the order stays there."""
    torch = _torch()
    on_device = torch.tensor(positions, device="cuda")

    def sort(view: SortView) -> Any:
        r = [float(value) for value in view.rotations[0, 2]]
        depths = on_device @ torch.tensor(r, device="cuda") + float(view.translations[0, 2])
        order = torch.argsort(depths, descending=True)
        torch.cuda.synchronize()
        return order

    return sort


def cub_pairs(positions: Positions) -> Sort:
    """CUB's radix sort of 32-bit keys and slots, by cuda-cccl; the order stays on the GPU."""
    import cupy
    from cuda import compute

    on_device = cupy.asarray(positions)
    slots = cupy.arange(len(positions), dtype=cupy.uint32)
    keys, keys_out, slots_out = (cupy.empty(len(positions), cupy.uint32) for _ in range(3))
    key = cupy.ElementwiseKernel(
        "raw float32 p, float32 x, float32 y, float32 z, float32 t",
        "uint32 key",
        """
        const float depth = x * p[3 * i] + y * p[3 * i + 1] + z * p[3 * i + 2] + t;
        const unsigned bits = __float_as_uint(depth);
        key = bits ^ (bits >> 31 ? 0xffffffffu : 0x80000000u);
        """,
        "depth_key",
    )

    def sort(view: SortView) -> Any:
        key(on_device.ravel(), *view.rotations[0, 2], view.translations[0, 2], keys)
        compute.radix_sort(
            d_in_keys=keys, d_out_keys=keys_out, d_in_values=slots, d_out_values=slots_out,
            order=compute.SortOrder.DESCENDING, num_items=len(positions),
        )  # fmt: skip
        cupy.cuda.Device().synchronize()
        return slots_out

    return sort


IN_HOST_MEMORY: dict[str, Callable[[Positions], Sort]] = {
    "shadygm/ROSplat, np.argsort": argsort,
    "np.argsort of depths": depth_argsort,
    "shadygm/ROSplat, torch": torch_uploading,
    "shadygm/ROSplat, cupy": cupy_uploading,
}

ON_DEVICE: dict[str, Callable[[Positions], Sort]] = {
    "torch.argsort": torch_on_device,
    "CUB pairs": cub_pairs,
}
