"""What src/python defines."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rosplat_core.payload import Arrays
from rosplat_core.splats import PackedSplats, Splats
from rosplat_core.view import SortView

_Stamp = tuple[int, int] | None

# --- Orders -----------------------------------------------------------------------------------

class DepthOrder:
    def __init__(self, threads: int = 0) -> None: ...
    @property
    def threads(self) -> int: ...
    def sort(
        self,
        view: SortView,
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

# --- Maps -------------------------------------------------------------------------------------

class BatchError(ValueError): ...

class Arrival:
    HEARD: ClassVar[Arrival]
    PULLED: ClassVar[Arrival]
    LAST: ClassVar[Arrival]
    def __init__(self, value: int) -> None: ...

def choose_map_qos(
    wished: tuple[bool, bool, int], offers: Sequence[tuple[bool, bool, int]], served: bool
) -> tuple[tuple[bool, bool, int], bool, bool]: ...

class MapPull:
    def __init__(self) -> None: ...
    @property
    def pulling(self) -> bool: ...
    held: bool
    def miss(self, heard: Any, now: float) -> None: ...
    def subscribed_anew(self, now: float) -> None: ...
    def lose(self, now: float) -> None: ...
    def awaits(self, number: int) -> bool: ...
    def hear(self, heard: Any, now: float, served: bool) -> Any: ...
    def answer(
        self, number: int, batches: Any, next_block: int, now: float, served: bool
    ) -> Any: ...
    def tick(self, now: float, served: bool) -> Any: ...

class GaussianMap:
    def __init__(self) -> None: ...
    @property
    def map_id(self) -> str: ...
    @property
    def capacity(self) -> int: ...
    def apply(self, batch: Any, arrival: Arrival = ...) -> dict[str, int]: ...
    def in_use(self, slot: int) -> bool: ...
    def origin(self, group: int = 0) -> list[float] | None: ...
    def pose(self, group: int) -> tuple[list[float], list[float]]: ...
    @property
    def revision(self) -> int: ...
    @property
    def splats(self) -> int: ...
    @property
    def missed(self) -> int: ...
    @property
    def pulled(self) -> bool: ...
    @property
    def complete(self) -> bool: ...
    @property
    def groups(self) -> int: ...
    @property
    def channels(self) -> list[str]: ...
    @property
    def model(self) -> int: ...
    @property
    def sample(self) -> NDArray[np.float64]: ...

class SortMap(GaussianMap):
    @property
    def positions(self) -> NDArray[np.float32]: ...
    @property
    def extents(self) -> NDArray[np.float32]: ...
    @property
    def pages(self) -> NDArray[np.uint32]: ...
    @property
    def frames(self) -> NDArray[np.float64]: ...
    @property
    def changed(self) -> NDArray[np.int64]: ...

class OccupancyMap(GaussianMap):
    def __init__(
        self, resolution: float, across: int, threads: int = 0, most: int = 1 << 24
    ) -> None: ...
    def place(self, position: Sequence[float], orientation: Sequence[float]) -> None: ...
    def find(self, least_depth: float) -> tuple[NDArray[np.int32], NDArray[np.float32]]: ...
    def surface(self, least_depth: float) -> dict[str, NDArray[Any]]: ...
    @property
    def too_large(self) -> int: ...
    @property
    def beyond(self) -> int: ...
    @property
    def voxels(self) -> int: ...
    @property
    def most(self) -> int: ...
    @property
    def full(self) -> bool: ...

def encode_payload(arrays: Arrays, usable: NDArray[np.bool_]) -> NDArray[np.uint8]: ...
def payload_suits(arrays: Arrays, usable: NDArray[np.bool_]) -> bool: ...
def decode_payload(
    payload: NDArray[np.uint8], count: int, sh_degree: int, format: str
) -> dict[str, NDArray[np.float32]]: ...
def pack_splats(arrays: Arrays | Splats, usable: NDArray[np.bool_]) -> NDArray[np.uint32]: ...
def put_in_order(array: NDArray[np.generic], order: NDArray[np.int64]) -> None: ...
def payload_size(count: int, sh_degree: int) -> int: ...

class PublishedBatch:
    FIELDS: tuple[str, ...]  # that a message has alike
    stamp: tuple[int, int] | None
    map_id: str
    revision: int
    operation: int
    expected_slots: int
    first_slot: int
    count: int
    slots: NDArray[np.uint32]
    group: int
    poses: dict[int, list[float]]
    sh_degree: int
    format: str
    payload: NDArray[np.uint8]
    model: int
    origin: list[float]
    channel_names: list[str]
    channels: NDArray[np.float32]

class PublishedMap:
    def __init__(
        self,
        chunk_bytes: int,
        compression: str,
        send: Callable[[PublishedBatch], None],
        warn: Callable[[str], None],
        settle: Callable[[], None],
    ) -> None: ...
    @property
    def map_id(self) -> str: ...
    def revision(self) -> int: ...
    def __len__(self) -> int: ...
    def groups(
        self,
    ) -> list[tuple[int, list[float] | None, NDArray[np.uint32], dict[str, Any]]]: ...
    def poses(self) -> dict[int, list[float]]: ...
    def replace(
        self, splats: Splats | PackedSplats, expected_slots: int | None, stamp: _Stamp
    ) -> None: ...
    def repeat(self) -> None: ...
    def expect(self, slots: int) -> None: ...
    def upsert(
        self,
        slots: int | NDArray[np.uint32],
        splats: Splats | PackedSplats,
        group: int,
        stamp: _Stamp,
    ) -> None: ...
    def append(
        self, splats: Splats | PackedSplats, group: int, stamp: _Stamp
    ) -> NDArray[np.uint32]: ...
    def erase(self, slots: NDArray[np.uint32], stamp: _Stamp) -> None: ...
    def erase_from(self, first_slot: int, count: int, stamp: _Stamp) -> None: ...
    def move(self, poses: Mapping[int, Sequence[float]], stamp: _Stamp) -> None: ...
    def pull(
        self, map_id: str, after_revision: int, first_block: int, most_sh_degree: int
    ) -> tuple[list[PublishedBatch], int]: ...

# --- Rendering --------------------------------------------------------------------------------

class DrawMode:
    COLOR: ClassVar[DrawMode]
    DEPTH: ClassVar[DrawMode]
    BILLBOARD: ClassVar[DrawMode]
    FLAT_BALL: ClassVar[DrawMode]
    GAUSSIAN_BALL: ClassVar[DrawMode]
    NORMALS: ClassVar[DrawMode]
    OPACITY: ClassVar[DrawMode]
    AGE: ClassVar[DrawMode]
    CHANNEL: ClassVar[DrawMode]

class ChannelColours:
    AUTO: ClassVar[ChannelColours]
    CATEGORIES: ClassVar[ChannelColours]
    GRADIENT: ClassVar[ChannelColours]

class OrderSource:
    __members__: ClassVar[dict[str, OrderSource]]
    AUTO: ClassVar[OrderSource]
    SIDECAR: ClassVar[OrderSource]
    OFF: ClassVar[OrderSource]

class Rasterizer:
    __members__: ClassVar[dict[str, Rasterizer]]
    AUTO: ClassVar[Rasterizer]
    TILES: ClassVar[Rasterizer]
    PROCESSOR: ClassVar[Rasterizer]

class ClipBox:
    enabled: bool
    centre: list[float]
    size: list[float]

class RenderSettings:
    mode: DrawMode
    max_sh_degree: int
    only_band: int
    float_blending: bool
    interactive: bool
    scale: float
    opacity: float
    model: int | None
    order: OrderSource
    rasterizer: Rasterizer
    profile: bool
    detail: str
    clip_box: ClipBox
    near_fade: float
    depth_range: list[float]
    age_range: float
    channel: str
    channel_colours: ChannelColours
    channel_range: list[float]

class Instructions:
    PLAIN: ClassVar[Instructions]
    AVX2: ClassVar[Instructions]
    AVX512: ClassVar[Instructions]
    BEST: ClassVar[Instructions]

class SplatCamera:
    def __init__(self, *numbers: Any) -> None: ...
    def crop(self, left: int, top: int, width: int, height: int) -> SplatCamera: ...

class Contributions:
    weight: NDArray[np.float32]
    energy: NDArray[np.float32]
    error: NDArray[np.float32]
    residual: NDArray[np.float32]

class RefitRates:
    def __init__(self, **rates: float) -> None: ...

class Refit:
    def __init__(self, *arrays: Any, **settings: Any) -> None: ...
    def step(
        self, camera: SplatCamera, target: NDArray[np.float32], rates: RefitRates
    ) -> float: ...
    def gradient_at(
        self, camera: SplatCamera, target: NDArray[np.float32]
    ) -> tuple[float, NDArray[np.float32]]: ...
    def splats(self) -> dict[str, NDArray[np.float32]]: ...

class CpuRenderer:
    settings: RenderSettings
    def __init__(self, threads: int, instructions: Instructions) -> None: ...
    def apply(self, batch: Any, arrival: Arrival = ...) -> dict[str, int]: ...
    def draw(self, camera: SplatCamera, **wanted: Any) -> dict[str, Any]: ...
    def merge(self) -> int: ...
    def splats(self) -> dict[str, Any]: ...
    def nodes(self, level: int, group: int = 0) -> dict[str, Any]: ...
    def pick(self, camera: SplatCamera) -> NDArray[np.uint32]: ...
    def contribute(
        self, camera: SplatCamera, sums: Contributions, residual: Any = None, lens: Any = None
    ) -> None: ...
    @property
    def map(self) -> GaussianMap: ...
    @property
    def map_bytes(self) -> int: ...
    @property
    def levels_bytes(self) -> int: ...
    @property
    def instructions(self) -> Instructions: ...
