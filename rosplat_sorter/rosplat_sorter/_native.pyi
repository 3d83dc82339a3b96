import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.view import View

class DepthOrder:
    def __init__(self, threads: int = 0) -> None: ...
    @property
    def threads(self) -> int: ...
    def sort(
        self, view: View, positions: NDArray[np.float32], extents: NDArray[np.float32]
    ) -> NDArray[np.uint32]: ...
