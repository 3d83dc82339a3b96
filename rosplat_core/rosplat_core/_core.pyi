"""
The engine in C++: what the package's modules are made of.
"""
from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import typing
import typing_extensions
__all__: list[str] = ['Arrival', 'BatchError', 'ChannelColours', 'ClipBox', 'Contributions', 'CpuRenderer', 'DepthOrder', 'DrawMode', 'GaussianMap', 'Instructions', 'MapPull', 'OccupancyMap', 'OrderError', 'OrderReader', 'OrderSource', 'PublishedBatch', 'PublishedMap', 'Rasterizer', 'Refit', 'RefitRates', 'RenderSettings', 'SortMap', 'SplatCamera', 'choose_map_qos', 'decode_payload', 'encode_payload', 'mark_segment', 'pack', 'pack_splats', 'payload_size', 'payload_suits', 'put_in_order']
class BatchError(ValueError):
    pass
class Arrival:
    """
    Members:
    
      HEARD
    
      PULLED
    
      LAST
    """
    HEARD: typing.ClassVar[Arrival]
    LAST: typing.ClassVar[Arrival]
    PULLED: typing.ClassVar[Arrival]
    __members__: typing.ClassVar[dict[str, Arrival]]
    @typing.overload
    def __eq__(self, other: Arrival) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: Arrival) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class MapPull:
    """
    What a receiver pulls of a map, and when.
    """
    held: bool
    def __init__(self) -> None:
        ...
    def answer(self, number: typing.SupportsInt | typing.SupportsIndex, batches: collections.abc.Sequence[tuple[str, typing.SupportsInt | typing.SupportsIndex, bool, typing.SupportsInt | typing.SupportsIndex, typing.Any]], next_block: typing.SupportsInt | typing.SupportsIndex, now: typing.SupportsFloat | typing.SupportsIndex, served: bool) -> tuple:
        ...
    def awaits(self, number: typing.SupportsInt | typing.SupportsIndex) -> bool:
        ...
    def hear(self, heard: tuple[str, typing.SupportsInt | typing.SupportsIndex, bool, typing.SupportsInt | typing.SupportsIndex, typing.Any], now: typing.SupportsFloat | typing.SupportsIndex, served: bool) -> tuple:
        ...
    def lose(self, now: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    def miss(self, heard: tuple[str, typing.SupportsInt | typing.SupportsIndex, bool, typing.SupportsInt | typing.SupportsIndex, typing.Any], now: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    def subscribed_anew(self, now: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    def tick(self, now: typing.SupportsFloat | typing.SupportsIndex, served: bool) -> tuple:
        ...
    @property
    def pulling(self) -> bool:
        ...
class GaussianMap:
    """
    A map's books, without what draws it.
    """
    def __init__(self) -> None:
        ...
    def apply(self, batch: typing.Any, arrival: Arrival = ...) -> dict:
        """
        Applies a rosplat_msgs/GaussianArray, or anything with its fields. Returns "missed", the
        number of batches missed before it, and "dropped", that of its splats that were dropped.
        Raises BatchError, naming the field, for a batch that contradicts itself.
        """
    def in_use(self, slot: typing.SupportsInt | typing.SupportsIndex) -> bool:
        ...
    def origin(self, group: typing.SupportsInt | typing.SupportsIndex = 0) -> typing.Annotated[list[float], "FixedSize(3)"] | None:
        """
        Of a group's positions, None where it never had splats. [m]
        """
    def pose(self, group: typing.SupportsInt | typing.SupportsIndex) -> tuple[typing.Annotated[list[float], "FixedSize(3)"], typing.Annotated[list[float], "FixedSize(4)"]]:
        """
        Where a group is: position [m], quaternion x y z w.
        """
    @property
    def capacity(self) -> int:
        ...
    @property
    def channels(self) -> list[str]:
        ...
    @property
    def complete(self) -> bool:
        ...
    @property
    def groups(self) -> int:
        ...
    @property
    def map_id(self) -> str:
        ...
    @property
    def missed(self) -> int:
        ...
    @property
    def model(self) -> int:
        ...
    @property
    def pulled(self) -> bool:
        ...
    @property
    def revision(self) -> int:
        ...
    @property
    def sample(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Where some thousand splats are, whatever its size, in its frame, float64 (n, 3). [m]
        """
    @property
    def splats(self) -> int:
        ...
class SortMap(GaussianMap):
    """
    A map as sorting needs it. What it holds may be looked at until the next batch.
    """
    def __init__(self) -> None:
        ...
    def apply(self, batch: typing.Any, arrival: Arrival = ...) -> dict:
        """
        Applies a rosplat_msgs/GaussianArray, or anything with its fields. Returns "missed", the
        number of batches missed before it, and "dropped", that of its splats that were dropped.
        Raises BatchError, naming the field, for a batch that contradicts itself.
        """
    @property
    def changed(self) -> numpy.typing.NDArray[numpy.int64]:
        """
        Runs of rows that the last batch changed: first, count.
        """
    @property
    def extents(self) -> numpy.typing.NDArray[numpy.float32]:
        """
        By row, float32 (rows,) [m]; negative where nothing can be seen.
        """
    @property
    def frames(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        By group, from what positions are relative to into the map's frame, float64 (g, 4, 4).
        """
    @property
    def pages(self) -> numpy.typing.NDArray[numpy.uint32]:
        """
        First slot, place and group of each page, by slots, uint32 (p, 3).
        """
    @property
    def positions(self) -> numpy.typing.NDArray[numpy.float32]:
        """
        By row, relative to the group's origin, float32 (rows, 3) [m].
        """
class OccupancyMap(GaussianMap):
    """
    A map as light that its splats take away in voxels.
    """
    def __init__(self, resolution: typing.SupportsFloat | typing.SupportsIndex, across: typing.SupportsInt | typing.SupportsIndex, threads: typing.SupportsInt | typing.SupportsIndex = 0, most: typing.SupportsInt | typing.SupportsIndex = 16777216) -> None:
        ...
    def apply(self, batch: typing.Any, arrival: Arrival = ...) -> dict:
        """
        Applies a rosplat_msgs/GaussianArray, or anything with its fields. Returns "missed", the
        number of batches missed before it, and "dropped", that of its splats that were dropped.
        Raises BatchError, naming the field, for a batch that contradicts itself.
        """
    def find(self, least_depth: typing.SupportsFloat | typing.SupportsIndex) -> tuple[numpy.typing.NDArray[numpy.int32], numpy.typing.NDArray[numpy.float32]]:
        """
        Cells int32 (n, 3) and optical depths along x, y, z float32 (n, 3).
        """
    def place(self, position: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(3)"], orientation: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(4)"]) -> None:
        """
        Where the map's frame is in the grid's: position [m], quaternion x y z w.
        """
    def surface(self, least_depth: typing.SupportsFloat | typing.SupportsIndex) -> dict:
        """
        Of the same voxels: int32 cells and float32 of the others, (n, 3).
        """
    @property
    def beyond(self) -> int:
        ...
    @property
    def full(self) -> bool:
        """
        Whether there would be too many voxels, and are none therefore.
        """
    @property
    def most(self) -> int:
        """
        How many voxels are held.
        """
    @property
    def too_large(self) -> int:
        ...
    @property
    def voxels(self) -> int:
        ...
class DepthOrder:
    """
    Keeps its workspace and threads between calls.
    """
    def __init__(self, threads: typing.SupportsInt | typing.SupportsIndex = 0) -> None:
        """
        threads: to sort with, 0 for as many as the machine runs at once.
        """
    def sort(self, view: typing.Any, positions: typing.Any, extents: typing.Any, pages: typing.Any, allocate: typing.Any) -> numpy.typing.NDArray[numpy.uint32]:
        """
        The visible slots back to front, uint32 (m,), in the array that allocate(m) returns.
        
        view: a rosplat_core.view.SortView. positions: float32 (rows, 3) [m]. extents: float32
        (rows,) [m], negative for what is never visible. pages: as SortMap.pages, uint32 (p, 3).
        All contiguous; other types raise TypeError, other sizes ValueError. One thread at a
        time.
        """
    @property
    def threads(self) -> int:
        ...
class OrderError(ValueError):
    pass
class OrderReader:
    """
    A viewer's side of SplatOrder.
    """
    def __init__(self) -> None:
        ...
    def read(self, encoding: typing.SupportsInt | typing.SupportsIndex, packed: typing_extensions.Buffer, count: typing.SupportsInt | typing.SupportsIndex, slot_bits: typing.SupportsInt | typing.SupportsIndex, segment: str, generation: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.uint32]:
        """
        The slots, uint32 (count,), of a packed or shared order. Raises OrderError.
        """
    @property
    def key(self) -> int:
        """
        For ViewCamera.segment_key; 0 while no segment can be read.
        """
class PublishedBatch:
    """
    The fields of a GaussianArray, flat.
    """
    FIELDS: typing.ClassVar[tuple] = ('map_id', 'revision', 'operation', 'expected_slots', 'first_slot', 'count', 'slots', 'group', 'sh_degree', 'format', 'payload', 'model', 'channel_names', 'channels')
    @property
    def channel_names(self) -> list[str]:
        ...
    @property
    def channels(self) -> numpy.typing.NDArray[numpy.float32]:
        ...
    @property
    def count(self) -> int:
        ...
    @property
    def expected_slots(self) -> int:
        ...
    @property
    def first_slot(self) -> int:
        ...
    @property
    def format(self) -> str:
        ...
    @property
    def group(self) -> int:
        ...
    @property
    def map_id(self) -> str:
        ...
    @property
    def model(self) -> int:
        ...
    @property
    def operation(self) -> int:
        ...
    @property
    def origin(self) -> typing.Annotated[list[float], "FixedSize(3)"]:
        ...
    @property
    def payload(self) -> numpy.typing.NDArray[numpy.uint8]:
        ...
    @property
    def poses(self) -> dict[int, typing.Annotated[list[float], "FixedSize(7)"]]:
        ...
    @property
    def revision(self) -> int:
        ...
    @property
    def sh_degree(self) -> int:
        ...
    @property
    def slots(self) -> numpy.typing.NDArray[numpy.uint32]:
        ...
    @property
    def stamp(self) -> tuple[int, int] | None:
        ...
class PublishedMap:
    """
    See published_map.hpp.
    """
    def __init__(self, chunk_bytes: typing.SupportsInt | typing.SupportsIndex, compression: str, send: collections.abc.Callable[[PublishedBatch], None], warn: collections.abc.Callable[[str], None], settle: collections.abc.Callable[[], None]) -> None:
        ...
    def __len__(self) -> int:
        ...
    def append(self, splats: typing.Any, group: typing.SupportsInt | typing.SupportsIndex, stamp: tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex] | None) -> numpy.typing.NDArray[numpy.uint32]:
        ...
    def erase(self, slots: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], stamp: tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex] | None) -> None:
        ...
    def erase_from(self, first_slot: typing.SupportsInt | typing.SupportsIndex, count: typing.SupportsInt | typing.SupportsIndex, stamp: tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex] | None) -> None:
        ...
    def expect(self, slots: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def groups(self) -> list:
        ...
    def move(self, poses: collections.abc.Mapping[typing.SupportsInt | typing.SupportsIndex, typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(7)"]], stamp: tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex] | None) -> None:
        ...
    def poses(self) -> dict[int, typing.Annotated[list[float], "FixedSize(7)"]]:
        ...
    def pull(self, arg0: str, arg1: typing.SupportsInt | typing.SupportsIndex, arg2: typing.SupportsInt | typing.SupportsIndex, arg3: typing.SupportsInt | typing.SupportsIndex) -> tuple[list, int]:
        ...
    def repeat(self) -> None:
        ...
    def replace(self, splats: typing.Any, expected: typing.SupportsInt | typing.SupportsIndex | None, stamp: tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex] | None) -> None:
        ...
    def revision(self) -> int:
        ...
    def upsert(self, slots: typing.SupportsInt | typing.SupportsIndex | typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], splats: typing.Any, group: typing.SupportsInt | typing.SupportsIndex, stamp: tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex] | None) -> None:
        ...
    @property
    def map_id(self) -> str:
        ...
class DrawMode:
    """
    Members:
    
      COLOR
    
      DEPTH
    
      BILLBOARD
    
      FLAT_BALL
    
      GAUSSIAN_BALL
    
      NORMALS
    
      OPACITY
    
      AGE
    
      CHANNEL
    """
    AGE: typing.ClassVar[DrawMode]
    BILLBOARD: typing.ClassVar[DrawMode]
    CHANNEL: typing.ClassVar[DrawMode]
    COLOR: typing.ClassVar[DrawMode]
    DEPTH: typing.ClassVar[DrawMode]
    FLAT_BALL: typing.ClassVar[DrawMode]
    GAUSSIAN_BALL: typing.ClassVar[DrawMode]
    NORMALS: typing.ClassVar[DrawMode]
    OPACITY: typing.ClassVar[DrawMode]
    __members__: typing.ClassVar[dict[str, DrawMode]]
    @typing.overload
    def __eq__(self, other: DrawMode) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: DrawMode) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class ChannelColours:
    """
    Members:
    
      AUTO
    
      CATEGORIES
    
      GRADIENT
    """
    AUTO: typing.ClassVar[ChannelColours]
    CATEGORIES: typing.ClassVar[ChannelColours]
    GRADIENT: typing.ClassVar[ChannelColours]
    __members__: typing.ClassVar[dict[str, ChannelColours]]
    @typing.overload
    def __eq__(self, other: ChannelColours) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: ChannelColours) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class OrderSource:
    """
    Members:
    
      AUTO
    
      SIDECAR
    
      OFF
    """
    AUTO: typing.ClassVar[OrderSource]
    OFF: typing.ClassVar[OrderSource]
    SIDECAR: typing.ClassVar[OrderSource]
    __members__: typing.ClassVar[dict[str, OrderSource]]
    @typing.overload
    def __eq__(self, other: OrderSource) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: OrderSource) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class Rasterizer:
    """
    Members:
    
      AUTO
    
      TILES
    
      PROCESSOR
    """
    AUTO: typing.ClassVar[Rasterizer]
    PROCESSOR: typing.ClassVar[Rasterizer]
    TILES: typing.ClassVar[Rasterizer]
    __members__: typing.ClassVar[dict[str, Rasterizer]]
    @typing.overload
    def __eq__(self, other: Rasterizer) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: Rasterizer) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class ClipBox:
    enabled: bool
    def __init__(self) -> None:
        ...
    @property
    def centre(self) -> typing.Annotated[list[float], "FixedSize(3)"]:
        ...
    @centre.setter
    def centre(self, arg0: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(3)"]) -> None:
        ...
    @property
    def size(self) -> typing.Annotated[list[float], "FixedSize(3)"]:
        ...
    @size.setter
    def size(self, arg0: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(3)"]) -> None:
        ...
class RenderSettings:
    channel: str
    channel_colours: ChannelColours
    clip_box: ClipBox
    detail: str
    interactive: bool
    mode: DrawMode
    order: OrderSource
    profile: bool
    rasterizer: Rasterizer
    def __init__(self) -> None:
        ...
    @property
    def age_range(self) -> float:
        ...
    @age_range.setter
    def age_range(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def channel_range(self) -> typing.Annotated[list[float], "FixedSize(2)"]:
        ...
    @channel_range.setter
    def channel_range(self, arg0: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(2)"]) -> None:
        ...
    @property
    def depth_range(self) -> tuple[float, float]:
        ...
    @depth_range.setter
    def depth_range(self, arg1: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex]) -> None:
        ...
    @property
    def max_sh_degree(self) -> int:
        ...
    @max_sh_degree.setter
    def max_sh_degree(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def model(self) -> int | None:
        ...
    @model.setter
    def model(self, arg1: typing.SupportsInt | typing.SupportsIndex | None) -> None:
        ...
    @property
    def near_fade(self) -> float:
        ...
    @near_fade.setter
    def near_fade(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def only_band(self) -> int:
        ...
    @only_band.setter
    def only_band(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def opacity(self) -> float:
        ...
    @opacity.setter
    def opacity(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def scale(self) -> float:
        ...
    @scale.setter
    def scale(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
class SplatCamera:
    def __init__(self, position: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(3)"], orientation: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(4)"], projection: typing.SupportsInt | typing.SupportsIndex, fx: typing.SupportsFloat | typing.SupportsIndex, fy: typing.SupportsFloat | typing.SupportsIndex, cx: typing.SupportsFloat | typing.SupportsIndex, cy: typing.SupportsFloat | typing.SupportsIndex, width: typing.SupportsFloat | typing.SupportsIndex, height: typing.SupportsFloat | typing.SupportsIndex, near: typing.SupportsFloat | typing.SupportsIndex = 0.01, far: typing.SupportsFloat | typing.SupportsIndex = 10000000000.0) -> None:
        ...
    def crop(self, left: typing.SupportsInt | typing.SupportsIndex, top: typing.SupportsInt | typing.SupportsIndex, width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex) -> SplatCamera:
        ...
class Instructions:
    """
    Members:
    
      PLAIN
    
      AVX2
    
      AVX512
    
      BEST
    """
    AVX2: typing.ClassVar[Instructions]
    AVX512: typing.ClassVar[Instructions]
    BEST: typing.ClassVar[Instructions]
    PLAIN: typing.ClassVar[Instructions]
    __members__: typing.ClassVar[dict[str, Instructions]]
    @typing.overload
    def __eq__(self, other: Instructions) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: Instructions) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class Contributions:
    def __init__(self) -> None:
        ...
    @property
    def energy(self) -> numpy.typing.NDArray[numpy.float32]:
        ...
    @property
    def error(self) -> numpy.typing.NDArray[numpy.float32]:
        ...
    @property
    def residual(self) -> numpy.typing.NDArray[numpy.float32]:
        ...
    @property
    def weight(self) -> numpy.typing.NDArray[numpy.float32]:
        ...
class CpuRenderer:
    settings: RenderSettings
    def __init__(self, threads: typing.SupportsInt | typing.SupportsIndex = 0, instructions: Instructions = ...) -> None:
        ...
    def apply(self, batch: typing.Any, arrival: Arrival = ...) -> dict:
        """
        Applies a rosplat_msgs/GaussianArray, or anything with its fields. Returns "missed", the
        number of batches missed before it, and "dropped", that of its splats that were dropped.
        Raises BatchError, naming the field, for a batch that contradicts itself.
        """
    def contribute(self, camera: SplatCamera, sums: Contributions, residual: typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None = None, lens: tuple[typing.Annotated[numpy.typing.ArrayLike, numpy.float32], typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex, bool] | None = None) -> None:
        ...
    def draw(self, camera: SplatCamera, mean_depth: bool = False, median_depth: bool = False, order: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32] | None = None, beside: collections.abc.Sequence[CpuRenderer] = [], samples: tuple[typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], typing.Annotated[numpy.typing.ArrayLike, numpy.float32], typing.Annotated[numpy.typing.ArrayLike, numpy.float32], typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(3)"] | None] | None = None, lens: tuple[typing.Annotated[numpy.typing.ArrayLike, numpy.float32], typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex, bool] | None = None, scene_depth: typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None = None) -> dict:
        """
        Draws the map; and, in one order with it, those of other renderers in the same frame. scene_depth: depths of opaque objects (height, width) [m], which hide splats whose centres are behind them; inf where there is none.
        """
    def merge(self) -> int:
        ...
    def nodes(self, level: typing.SupportsInt | typing.SupportsIndex, group: typing.SupportsInt | typing.SupportsIndex = 0) -> dict:
        ...
    def pick(self, camera: SplatCamera) -> numpy.typing.NDArray[numpy.uint32]:
        ...
    def splats(self) -> dict:
        ...
    @property
    def instructions(self) -> str:
        ...
    @property
    def levels_bytes(self) -> int:
        ...
    @property
    def map(self) -> GaussianMap:
        """
        The books of the map that it draws.
        """
    @property
    def map_bytes(self) -> int:
        ...
class RefitRates:
    def __init__(self, *, position: typing.SupportsFloat | typing.SupportsIndex, scale: typing.SupportsFloat | typing.SupportsIndex, rotation: typing.SupportsFloat | typing.SupportsIndex, opacity: typing.SupportsFloat | typing.SupportsIndex, colour: typing.SupportsFloat | typing.SupportsIndex, bands: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
class Refit:
    def __init__(self, positions: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], orientations: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], scales: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], opacities: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], sh: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], origin: typing.Annotated[collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(3)"], model: typing.SupportsInt | typing.SupportsIndex, threads: typing.SupportsInt | typing.SupportsIndex = 0, instructions: Instructions = ...) -> None:
        ...
    def gradient_at(self, camera: SplatCamera, target: typing.Annotated[numpy.typing.ArrayLike, numpy.float32]) -> tuple[float, numpy.typing.NDArray[numpy.float32]]:
        ...
    def splats(self) -> dict:
        ...
    def step(self, camera: SplatCamera, target: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], rates: RefitRates) -> float:
        ...
def choose_map_qos(wished: tuple[bool, bool, typing.SupportsInt | typing.SupportsIndex], offers: collections.abc.Sequence[tuple[bool, bool, typing.SupportsInt | typing.SupportsIndex]], served: bool) -> tuple[tuple[bool, bool, int], bool, bool]:
    """
    What a subscription to a map asks for, and whether it then hears no best effort publisher, and no volatile one. Each QoS: reliable, transient local, depth.
    """
def decode_payload(payload: typing.Annotated[numpy.typing.ArrayLike, numpy.uint8], count: typing.SupportsInt | typing.SupportsIndex, sh_degree: typing.SupportsInt | typing.SupportsIndex, format: str) -> dict:
    ...
def encode_payload(arrays: typing.Any, usable: typing.Annotated[numpy.typing.ArrayLike, numpy.bool]) -> numpy.typing.NDArray[numpy.uint8]:
    ...
def mark_segment(segment: typing_extensions.Buffer, generation: typing.SupportsInt | typing.SupportsIndex) -> None:
    """
    Writes a segment's generation, after what was written to it before and before what is
    written next. segment: its mapping.
    """
def pack(slots: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], bits: typing.SupportsInt | typing.SupportsIndex, packed: typing_extensions.Buffer) -> None:
    """
    Writes slots, uint32 (n,), as SplatOrder.packed into (n * bits + 7) / 8 bytes.
    """
def pack_splats(arrays: typing.Any, usable: typing.Annotated[numpy.typing.ArrayLike, numpy.bool]) -> numpy.typing.NDArray[numpy.uint32]:
    ...
def payload_size(count: typing.SupportsInt | typing.SupportsIndex, sh_degree: typing.SupportsInt | typing.SupportsIndex) -> int:
    ...
def payload_suits(arrays: typing.Any, usable: typing.Annotated[numpy.typing.ArrayLike, numpy.bool]) -> bool:
    ...
def put_in_order(array: numpy.ndarray, order: typing.Annotated[numpy.typing.ArrayLike, numpy.int64]) -> None:
    ...
