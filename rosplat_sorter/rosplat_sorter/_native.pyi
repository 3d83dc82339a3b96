from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.view import View

class DepthOrder:
    def __init__(self, threads: int = 0) -> None: ...
    @property
    def threads(self) -> int: ...
    def sort(
        self,
        view: View,
        positions: NDArray[np.float32],
        extents: NDArray[np.float32],
        pages: NDArray[np.uint32],
        allocate: Callable[[int], NDArray[np.uint32]],
    ) -> NDArray[np.uint32]: ...

class OrderError(ValueError): ...

class OrderReader:
    def __init__(self) -> None: ...
    @property
    def key(self) -> int: ...
    def read(
        self,
        encoding: int,
        packed: Any,
        count: int,
        slot_bits: int,
        segment: str,
        generation: int,
    ) -> NDArray[np.uint32]: ...

def pack(slots: NDArray[np.uint32], bits: int, packed: Any) -> None: ...
def mark_segment(segment: Any, generation: int) -> None: ...
