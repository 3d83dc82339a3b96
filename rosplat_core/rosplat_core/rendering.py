"""Pictures of maps, drawn by the processor: exact, and without a graphics card.

Kerbl et al. 2023 as gsplat draws it: 0.3 px^2 are added to each splat's covariance in the picture,
splats end where their alpha is 1/255, a pixel ends where less than 1e-4 of it is left.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from threading import Lock
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core, harmonics
from rosplat_core.cameras import Camera
from rosplat_core.maps import REPLACE, UPSERT, batch_of, move_of
from rosplat_core.models import Model
from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.splats import Splats, check_kind, check_splats
from rosplat_core.view import frame_at

ChannelColours = _core.ChannelColours
ClipBox = _core.ClipBox
Contributions = _core.Contributions
DrawMode = _core.DrawMode
Instructions = _core.Instructions
OrderSource = _core.OrderSource
Rasterizer = _core.Rasterizer
RenderSettings = _core.RenderSettings
SplatCamera = _core.SplatCamera
over_opaque = _core.over_opaque

MOST_PSNR = 150.0  # of equal pictures, as JSON has no infinity [dB]


def psnr_of(square: float) -> float:
    """The PSNR of a mean square of errors, for a peak of 1; NaN stays NaN. [dB]"""
    return -10 * math.log10(max(square, 10 ** (-MOST_PSNR / 10)))


MOST_THREADS = 1024
BATCH_BYTES = 8_000_000  # as in publishers' batches
MAP = "map"


class Renderer(Protocol):
    """Holds a map and draws it: a CpuRenderer, or rviz_gaussian_plugin.offscreen.CardRenderer."""

    context: Any
    """Of OpenGL, in which objects are to be drawn; None: anywhere."""

    def beside(self) -> Any:
        """Another map, empty, whose pictures this draws with its own; it has `apply`."""

    def over(
        self, camera: Camera, below: Any = None, *, beside: Sequence[Any] = ()
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
        """What a camera sees of maps and of opaque objects, which hide the splats whose centres are
        behind them: RGB (height, width, 3), depths along its z [m], and where splats are a surface,
        which takes half of the light. There, depths are where half is left; elsewhere they are the
        objects', inf where there is none.

        below: the objects' RGB and depths or, with a context, the framebuffer that they are in;
        None: there are none. beside: maps to draw, too, which beside() made."""


class CpuRenderer(_core.CpuRenderer):
    """Holds a map in memory and draws pictures of it.

    Threads that draw wait for one another. Whatever else is called needs the renderer alone.
    """

    context = None

    def __init__(
        self,
        splats: Splats | None = None,
        *,
        threads: int = 0,
        instructions: _core.Instructions = Instructions.BEST,
    ) -> None:
        """threads: how many draw, 0 for as many as the machine runs at once. instructions: vector
        instructions of the processor to draw with, by default the best that it has. Raises
        ValueError for threads that are not 0 to 1024.
        """
        if threads not in range(MOST_THREADS + 1):
            raise ValueError(f"threads is {threads!r}, expected 0 to {MOST_THREADS}")
        super().__init__(threads, instructions)
        self._drawing = Lock()
        if splats is not None:
            check_splats(splats)
            insert_all(self, splats)

    @property
    def model(self) -> Model:
        """The model that it draws by."""
        return Model(self.map.model if self.settings.model is None else self.settings.model)

    def render(
        self, camera: Camera, *, scene_depth: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        """What a camera sees: premultiplied RGBA over nothing, float32 (height, width, 4).

        scene_depth: (height, width) depths of opaque objects along the camera's z [m], inf where
        there is none. They hide the splats whose centres are behind them: the picture over a
        picture of the objects is one of both. Raises ValueError for depths that no object can have.
        """
        colour: NDArray[np.float32] = self.draw(posed(camera), scene_depth=scene_depth)["colour"]
        return colour

    def beside(self) -> CpuRenderer:
        """Another map, as of Renderer."""
        return CpuRenderer()

    def over(
        self,
        camera: Camera,
        below: tuple[NDArray[np.uint8], NDArray[np.float32]] | None = None,
        *,
        beside: Sequence[CpuRenderer] = (),
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
        """As of Renderer."""
        drawn = self.draw(
            posed(camera), beside=list(beside), median_depth=True,
            scene_depth=below[1] if below else None,
        )  # fmt: skip
        colour, depth, surface = over_opaque(
            drawn["colour"], drawn["depth"][..., 0], *(below or ())
        )
        return colour, depth, surface

    def snapshot(self) -> tuple[NDArray[np.uint32], Splats]:
        """The slots in use, (n,), and their splats as they are drawn, in the map's frame."""
        arrays = self.splats()
        slots, groups = arrays.pop("slots"), arrays.pop("groups")
        for group in np.unique(groups):
            turn = frame_at(*self.map.pose(int(group)))[:3, :3]
            if arrays["sh"].shape[1] > 1 and not np.array_equal(turn, np.eye(3)):
                of_group = groups == group
                arrays["sh"][of_group] = harmonics.turned(arrays["sh"][of_group], turn)
        return slots, Splats(**arrays, model=Model(self.map.model))

    def draw(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """As _core.CpuRenderer.draw()."""
        with self._drawing:
            return super().draw(*args, **kwargs)


def render(splats: Splats, camera: Camera) -> NDArray[np.float32]:
    """A picture of splats: premultiplied RGBA over nothing, float32 (height, width, 4).

    To draw several pictures of the same splats, keep a CpuRenderer.
    """
    check_splats(splats)
    return CpuRenderer(splats).render(camera)


def pose(camera: Camera) -> tuple[Any, ...]:
    """A camera's numbers, as SplatCamera and PosedCamera take them. Raises ValueError for a
    panorama, which lens_pictures.take_picture() draws."""
    check_kind(camera, Camera, "camera")
    if camera.model:
        raise ValueError(f"camera {camera.id}: {camera.model} has no pinhole picture")
    return (
        tuple(camera.position.tolist()), tuple(camera.orientation.tolist()),
        int(camera.orthographic), camera.fx, camera.fy, camera.cx, camera.cy,
        camera.width, camera.height, camera.near, camera.far,
    )  # fmt: skip


def posed(camera: Camera) -> _core.SplatCamera:
    """A camera as CpuRenderer takes it."""
    return SplatCamera(*pose(camera))


# --- Batches of splats for a CpuRenderer, a GaussianMap or the plugin's Renderer ------------------


def batches(splats: Splats) -> Iterator[slice]:
    """Slices of the splats, the batches in which a publisher would send them."""
    step = max(1, BATCH_BYTES * len(splats) // max(1, splats.nbytes))
    for start in range(0, len(splats), step):
        yield slice(start, min(start + step, len(splats)))


def insert(
    renderer: Any, splats: Splats, part: slice, revision: int, first: int = 0, **fields: Any
) -> None:
    """Writes a part of the splats to a renderer's slots of the same numbers, but for those before
    the first; revision 1 begins. fields: others of a GaussianArray."""
    operation = REPLACE if revision == 1 else UPSERT
    renderer.apply(
        batch_of(
            splats, part, operation=operation, first_slot=first + part.start, map_id=MAP,
            revision=revision, **({"expected_slots": len(splats)} | fields),
        )
    )  # fmt: skip


def insert_all(renderer: Any, splats: Splats) -> int:
    """Gives a renderer a map, batch by batch; returns the last one's revision."""
    return insert_groups(renderer, [splats])


def insert_groups(renderer: Any, parts: Sequence[Splats]) -> int:
    """As insert_all, with several sets of splats, each as the group of its number."""
    revision, first, expected = 0, 0, sum(map(len, parts))
    for number, splats in enumerate(parts):
        for part in batches(splats):
            revision += 1
            insert(renderer, splats, part, revision, first, group=number, expected_slots=expected)
        first += -(-len(splats) // SLOTS_PER_PAGE) * SLOTS_PER_PAGE  # a block is of one group
    return revision


def edit(
    renderer: Any, operation: int, slots: NDArray[np.integer], splats: Splats, revision: int
) -> None:
    """UPSERT: writes splats to the slots. DELETE: empties the slots, with splats of length 0."""
    renderer.apply(
        batch_of(
            splats, operation=operation, count=len(slots), slots=slots.astype(np.uint32),
            map_id=MAP, revision=revision,
        )
    )  # fmt: skip


def move(renderer: Any, poses: Mapping[int, Sequence[float]], revision: int) -> None:
    """Gives groups poses in the map's frame: position x y z [m], quaternion x y z w."""
    renderer.apply(move_of(poses, map_id=MAP, revision=revision))
