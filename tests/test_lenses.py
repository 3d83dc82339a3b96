"""Lenses against OpenCV's, and their pictures against pictures drawn at once and the reference."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from drawing import CAMERAS, cloud, decibels
from rosplat_core.cameras import Camera, look_at
from rosplat_core.generated import generate
from rosplat_core.lens_pictures import Shutter, take_picture
from rosplat_core.lens_warps import Straightened, Warp
from rosplat_core.lenses import Lens, LensError
from rosplat_core.models import Model
from rosplat_core.rendering import Contributions, CpuRenderer, DrawMode, posed
from rosplat_lab import reference
from rosplat_lab.reference.rays import along_rays

SIZE = {"width": 320, "height": 240, "fx": 210.0, "fy": 205.0, "cx": 161.3, "cy": 119.7}
# As calibrations of real cameras have them.
LENSES = {
    "plumb_bob": Lens(**SIZE, model="plumb_bob", coefficients=(-0.28, 0.07, 3e-4, -5e-4, 0.01)),
    "rational_polynomial": Lens(
        **SIZE,
        model="rational_polynomial",
        coefficients=(0.45, -2.6, 8e-4, -1e-4, 1.5, 0.33, -2.4, 1.45),
    ),
    "equidistant": Lens(**SIZE, model="equidistant", coefficients=(-0.02, 0.01, -0.005, 0.001)),
    "double_sphere": Lens(**SIZE, model="double_sphere", coefficients=(-0.18, 0.59)),
    "ftheta": Lens(**SIZE, model="ftheta", coefficients=(0, 1, -0.02, 0.05, -0.09, 0.03, 1.5)),
    # As depthai has those of an OAK: thin prisms, and a sensor tilted by half a degree.
    "rational_polynomial of 12": Lens(
        **SIZE,
        model="rational_polynomial",
        coefficients=(0.45, -2.6, 8e-4, -1e-4, 1.5, 0.33, -2.4, 1.45, 4e-3, -2e-3, -3e-3, 1e-3),
    ),
    "rational_polynomial of 14": Lens(
        **SIZE,
        model="rational_polynomial",
        coefficients=(
            0.45,
            -2.6,
            8e-4,
            -1e-4,
            1.5,
            0.33,
            -2.4,
            1.45,
            4e-3,
            -2e-3,
            -3e-3,
            1e-3,
            0.01,
            -0.008,
        ),
    ),
}
EYE = look_at((2.0, 1.0, 0.7), (0, 0, 0))


def pixels_of(lens: Lens) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    return np.stack([columns, rows], axis=-1).astype(np.float64)


@pytest.mark.parametrize("model", sorted(set(LENSES) - {"double_sphere", "ftheta"}))
def test_rays_arrive_where_opencv_has_them(model: str) -> None:
    lens = LENSES[model]
    rays = lens.rays(pixels_of(lens))
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    flat, d = rays.reshape(-1, 3), np.array(lens.coefficients)
    if model == "equidistant":
        points = (flat[:, :2] / flat[:, 2:])[None]
        arrives = cv2.fisheye.distortPoints(points, matrix, d)[0]
    else:
        arrives = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), matrix, d)[0][:, 0]
    np.testing.assert_allclose(arrives, pixels_of(lens).reshape(-1, 2), atol=1e-4)
    np.testing.assert_allclose(lens.project(rays), pixels_of(lens), atol=1e-4)


def test_rays_of_a_double_sphere_are_those_of_its_authors() -> None:
    """Usenko et al. 2018, equations 46 to 49."""
    lens = LENSES["double_sphere"]
    pixels = pixels_of(lens)
    xi, alpha = lens.coefficients
    m = (pixels - (lens.cx, lens.cy)) / (lens.fx, lens.fy)
    square = (m**2).sum(-1)
    ahead = (1 - alpha**2 * square) / (alpha * np.sqrt(1 - (2 * alpha - 1) * square) + 1 - alpha)
    length = (ahead * xi + np.sqrt(ahead**2 + (1 - xi**2) * square)) / (ahead**2 + square)
    rays = np.concatenate([m, ahead[..., None]], -1) * length[..., None] - (0, 0, xi)
    np.testing.assert_allclose(lens.rays(pixels), rays, atol=1e-9)
    np.testing.assert_allclose(lens.project(rays), pixels, atol=1e-6)
    assert math.degrees(lens.most_angle) > 100  # it sees behind itself


def test_an_f_theta_lens_is_its_polynomials() -> None:
    lens = LENSES["ftheta"]
    angles = np.linspace(0, 1.4, 50)
    rays = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    distances = np.polynomial.polynomial.polyval(angles, lens.coefficients[:6])
    np.testing.assert_allclose(lens.project(rays)[:, 0], lens.cx + lens.fx * distances, atol=1e-9)
    beyond = [math.sin(1.51), 0, math.cos(1.51)]
    assert np.isnan(lens.project(beyond)).all()  # the largest angle is 1.5
    back = (0, 1, 0.1, -0.02, 0, 0)  # the exact one
    lens = replace(lens, coefficients=(0, 1, -0.1, 0, 0, 0, 0, *back))
    pixels = np.stack([lens.cx + lens.fx * np.linspace(0, 1, 30), np.full(30, lens.cy)], axis=-1)
    found = lens.rays(pixels)
    expected = np.polynomial.polynomial.polyval(np.linspace(0, 1, 30), back)
    np.testing.assert_allclose(np.arctan2(found[:, 0], found[:, 2]), expected, atol=1e-9)


def test_rays_that_do_not_arrive_are_none() -> None:
    behind = np.array([[0.1, 0.2, -1.0]])
    for lens in LENSES.values():
        assert np.isnan(lens.project(np.array([[30.0, 0.0, 1.0]]))).all() or lens.model in (
            "equidistant", "rational_polynomial", "double_sphere",
        )  # fmt: skip
        if not lens.is_fisheye:
            assert np.isnan(lens.project(behind)).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"width": 0}, "width is 0, expected 1 to 8192"),
        ({"fx": 0.0, "fy": 0.0}, "k: focal lengths are 0.0, 0.0, expected more than 0"),
        ({"cx": math.nan}, "a number is not finite"),
        ({"fx": 0.0, "fy": 0.0}, "not calibrated"),
        ({"model": "eucm"}, "distortion_model is 'eucm', known are plumb_bob"),
        ({"model": "none", "coefficients": (1,)}, "d has 1 numbers, expected 0"),
        ({"model": "a\x1b[31m"}, r"distortion_model is 'a\\x1b\[31m'"),
        (
            {"model": "rational_polynomial", "coefficients": (1,) * 15},
            "d has 15 numbers, expected 8, 12, 14 of",
        ),
        ({"model": "equidistant", "coefficients": (0, 0, 0, 0, 1)}, "d has 5 numbers, expected 4"),
        ({"model": "double_sphere", "coefficients": (0, 1.5)}, "d: xi is 0, alpha 1.5, expected"),
        ({"model": "ftheta", "coefficients": (9, 1)}, "d: expected polynomials that begin with 0"),
        ({"model": "ftheta", "coefficients": (0, -1)}, "and then rise"),
    ],
)
def test_what_is_no_lens_names_the_field(changes: dict[str, object], said: str) -> None:
    with pytest.raises(LensError, match=said):
        Lens(**(SIZE | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "coefficients", "model"),
    [
        ("fisheye", (0.1,), "equidistant"),
        ("KANNALA_BRANDT4", (0.1,), "equidistant"),
        ("radtan", (0.1,), "plumb_bob"),
        ("Brown-Conrady", (0.1,), "plumb_bob"),
        ("none", (0.0,) * 5, ""),
        ("plumb_bob", (0.1, 0, 0, 0, 0, 0.2, 0, 0), "rational_polynomial"),
        ("plumb_bob", (0.1, 0, 0, 0, 0, 0, 0, 0), "plumb_bob"),
    ],
)
def test_names_that_drivers_have_for_models(
    name: str, coefficients: tuple[float, ...], model: str
) -> None:
    assert Lens(**(SIZE | {"model": name, "coefficients": coefficients})).model == model


def test_a_distortion_that_folds_is_refused() -> None:
    with pytest.raises(LensError, match="the distortion folds: no ray arrives at pixel 0, 0"):
        Warp(Lens(**SIZE, model="plumb_bob", coefficients=(-0.6,)))


def test_around_a_fisheye_s_picture_nothing_is() -> None:
    lens = Lens(320, 320, 70.0, 70.0, 159.5, 159.5, "equidistant", (0.0, -0.02))
    warp = Warp(lens)
    away = np.linalg.norm(pixels_of(lens) - 159.5, axis=-1)
    assert warp.met[away < 99].all() and not warp.met[0, 0]
    picture = take_picture(CpuRenderer(cloud()), warp, EYE, depth="median")
    assert not picture.colour[~warp.met].any() and np.isnan(picture.depth[~warp.met]).all()


def test_a_warped_picture_is_the_one_drawn_at_once() -> None:
    """A distortion of next to nothing: what is left is what the warp costs."""
    renderer = CpuRenderer(cloud())
    straight = take_picture(renderer, Warp(Lens(**SIZE)), EYE, depth="median").colour
    bent = Lens(**SIZE, model="plumb_bob", coefficients=(1e-12,))
    warped = take_picture(renderer, Warp(bent), EYE, depth="median").colour
    assert not np.array_equal(straight, warped)
    assert decibels(warped, straight) >= 50


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_points_are_where_the_lens_has_them(lens: Lens) -> None:
    """Small, opaque splats: each is brightest where project() takes it."""
    random = np.random.default_rng(5)
    splats = generate(1)
    pixels = np.array([(12.0, 9.0), (160.0, 120.0), (300.0, 20.0), (40.0, 200.0), (310.0, 231.0)])
    rays = lens.rays(pixels)
    places = rays / rays[:, 2:] * random.uniform(2, 4, (len(rays), 1))
    splats = splats[np.zeros(len(places), int)]
    splats.origin[:] = 0
    splats.positions[:] = places
    splats.scales[:] = 0.004
    splats.opacities[:] = 1
    splats.sh[:] = 0
    splats.sh[:, 0] = 1
    picture = take_picture(CpuRenderer(splats), Warp(lens), np.eye(4), depth="median")
    for (x, y), place in zip(pixels.astype(int), places, strict=True):
        window = picture.colour[max(y - 4, 0) : y + 5, max(x - 4, 0) : x + 5, 0]
        brightest = np.unravel_index(window.argmax(), window.shape)
        assert (brightest[0] + max(y - 4, 0), brightest[1] + max(x - 4, 0)) == (y, x)
        assert picture.depth is not None
        assert picture.depth[y, x] == pytest.approx(place[2], rel=1e-3)  # within the splat


def test_a_wide_fisheye_sees_what_narrow_cameras_see() -> None:
    """Beyond 50 degrees off the axis, the faces of a cube are drawn."""
    splats = cloud()  # around the camera, small and far: the others' shapes differ by camera
    splats.positions[:] *= 3 / np.linalg.norm(splats.positions, axis=1, keepdims=True)
    splats.scales[:] = np.random.default_rng(6).uniform(0.05, 0.2, (len(splats), 1))
    renderer = CpuRenderer(splats)
    fisheye = Lens(300, 300, 90.0, 90.0, 149.5, 149.5, "equidistant", (0.0,) * 4)
    warp = Warp(fisheye)
    assert len(warp.cameras(np.eye(4), 0.01, 100.0)) == 6
    inside = look_at((0.1, 0.0, 0.0), (1.0, 0.0, 0.0))
    wide = take_picture(renderer, warp, inside).colour
    # To the right: what a pinhole camera sees that looks 80 degrees aside.
    angle = math.radians(80)
    turn = np.eye(4)
    turn[:3, :3] = [
        [math.cos(angle), 0, -math.sin(angle)],
        [0, 1, 0],
        [math.sin(angle), 0, math.cos(angle)],
    ]
    narrow = Lens(60, 60, 90.0, 90.0, 29.5, 29.5)
    aside = take_picture(renderer, Warp(narrow), turn @ inside).colour
    rays = narrow.rays(pixels_of(narrow)) @ turn[:3, :3]
    x, y = np.moveaxis(fisheye.project(rays), -1, 0).astype(np.float32)
    seen = cv2.remap(wide, x, y, cv2.INTER_CUBIC)
    assert aside.std() > 0.05  # there was something to see
    assert decibels(seen, aside) >= 28  # each picture blurs by 0.3 px^2 of its own pixels


@pytest.mark.parametrize("model", [Model.EWA, Model.RAY])
@pytest.mark.parametrize("name", ["pinhole", "plumb_bob", "round"])
def test_a_rolling_shutter_that_rests_sees_the_whole_picture(name: str, model: Model) -> None:
    lens = {
        "pinhole": Lens(**SIZE),
        "plumb_bob": LENSES["plumb_bob"],
        # Of 180 degrees, and dark above and below.
        "round": Lens(100, 150, 35.0, 35.0, 49.5, 74.5, "ftheta", (0, 1, 0, 0, 0, 0, 1.57)),
    }[name]
    renderer, wanted = CpuRenderer(cloud(model)), {"depth": "expected", "normals": True}
    whole = take_picture(renderer, Warp(lens), EYE, **wanted)
    rows = Shutter(lens).take(renderer, lambda _: EYE, **wanted)
    assert decibels(rows.colour, whole.colour) > (45 if name == "plumb_bob" else 60)
    for taken, known in ((rows.depth, whole.depth), (rows.normals, whole.normals)):
        assert taken is not None and known is not None and taken.shape == known.shape
        assert np.mean(np.isnan(taken) != np.isnan(known)) < 2e-3
        both = np.isfinite(taken) & np.isfinite(known)
        assert np.isclose(taken[both], known[both], rtol=0.02, atol=0.02).mean() > 0.98
    assert Warp(lens).met.any(axis=1).all() != (name == "round")


@pytest.mark.parametrize("kind", ["median", "expected"])
def test_depths_are_the_reference_s(kind: str) -> None:
    camera = CAMERAS["outside"]
    lens = Lens(camera.width, camera.height, camera.fx, camera.fy, camera.cx - 0.5, camera.cy - 0.5)
    renderer = CpuRenderer(cloud())
    depth = take_picture(renderer, Warp(lens), camera.world_to_camera, depth=kind).depth
    assert depth is not None
    twin = reference.render(cloud(), camera)
    expected = twin.median if kind == "median" else twin.depth
    surface = twin.rgba[..., 3] >= 0.5
    clear = np.abs(twin.rgba[..., 3] - 0.5) > 1e-3
    np.testing.assert_array_equal(np.isinf(depth)[clear], ~surface[clear])
    both = surface & np.isfinite(depth)
    assert np.isclose(depth[both], expected[both], rtol=1e-3).mean() > 0.998


def test_an_unknown_depth_is_refused() -> None:
    with pytest.raises(ValueError, match="depth is 'mean', expected one of median, expected"):
        take_picture(CpuRenderer(cloud()), Warp(Lens(**SIZE)), EYE, depth="mean")


def test_normals_look_at_the_camera() -> None:
    """Of flat splats on a wall, however the camera is turned."""
    wall = generate(1)[np.zeros(400, int)]
    wall.origin[:] = 0
    grid = np.linspace(-1, 1, 20)
    wall.positions[:] = np.stack([*np.meshgrid(grid, grid), np.zeros((20, 20))], -1).reshape(-1, 3)
    wall.scales[:] = (0.1, 0.1, 0.001)
    wall.orientations[:] = (0, 0, 0, 1)
    wall.opacities[:] = 0.9
    renderer = CpuRenderer(wall)
    for eye in ((0.5, 0.3, 2.0), (0.5, 0.3, -2.0)):
        pose = look_at(eye, (0, 0, 0))
        normals = take_picture(renderer, Warp(Lens(**SIZE)), pose, normals=True).normals
        assert normals is not None
        seen = np.isfinite(normals).all(axis=-1)
        assert seen.mean() > 0.2
        expected = pose[:3, :3] @ (0, 0, math.copysign(1, eye[2]))
        np.testing.assert_allclose(normals[seen], np.tile(expected, (seen.sum(), 1)), atol=1e-3)
        assert expected[2] < 0  # towards the camera
    assert renderer.settings.mode == DrawMode.COLOR


@pytest.mark.parametrize("lens", [*LENSES.values(), Lens(**SIZE)], ids=[*LENSES, "pinhole"])
def test_what_pixels_have_goes_back_to_those_they_are_made_of(lens: Lens) -> None:
    """back() is the adjoint of colour(): both have the same inner product."""
    random = np.random.default_rng(3)
    sheets = Warp(lens).sheets(Model.EWA)
    pictures = [
        random.normal(size=(c.height, c.width, 1)).astype(np.float32)
        for c, _ in sheets.cameras(np.eye(4), 0.01, 100.0)
    ]
    values = random.normal(size=(lens.height, lens.width)).astype(np.float32)
    there = np.sum(sheets.colour(pictures)[..., 0] * values, dtype=np.float64)
    back = sum(
        np.sum(picture[..., 0] * dealt, dtype=np.float64)
        for picture, dealt in zip(pictures, sheets.back(values), strict=True)
    )
    assert there == pytest.approx(back, rel=1e-3, abs=0.1)


def test_cameras_of_a_pinhole_lens_are_the_lens() -> None:
    (camera,) = Warp(Lens(**SIZE)).cameras(EYE, 0.5, 7.0)
    assert isinstance(camera, Camera)
    assert (camera.cx, camera.near, camera.far) == (SIZE["cx"] + 0.5, 0.5, 7.0)
    np.testing.assert_array_equal(camera.world_to_camera, EYE)


@pytest.mark.parametrize("model", LENSES)
def test_a_straightened_picture_is_that_of_a_pinhole_camera(model: str) -> None:
    # Along rays: ellipses have other shapes in a fisheye's picture than in a pinhole's.
    renderer = CpuRenderer(replace(generate(5000, seed=1), model=Model.RAY))
    lens = LENSES[model]
    counts = Warp(lens).met.copy()
    counts[:20] = False
    curved = np.clip(take_picture(renderer, Warp(lens), EYE).colour, 0, 1)
    straightened = Straightened(lens)
    straight, met = straightened.picture((255 * curved + 0.5).astype(np.uint8), counts)
    camera = replace(straightened.camera, world_to_camera=EYE)
    expected = np.clip(renderer.render(camera)[..., :3], 0, 1)
    assert met.shape == (camera.height, camera.width) and 0.5 < met.mean() < 1
    assert decibels(straight[met] / np.float32(255), expected[met]) > 35


def test_a_straight_picture_stays_as_it_is() -> None:
    lens = Lens(**SIZE)
    straightened = Straightened(lens)
    picture, counts = np.zeros((240, 320, 3), np.uint8), np.ones((240, 320), bool)
    assert straightened.picture(picture, counts) == (picture, counts)
    assert (straightened.camera.cx, straightened.camera.cy) == (lens.cx + 0.5, lens.cy + 0.5)


FISHEYE = Lens(64, 64, 30.0, 30.0, 31.5, 31.5, "equidistant")  # to 86 degrees in the corners
BEHIND = replace(FISHEYE, fx=18.0, fy=18.0)  # to 142 degrees


@pytest.mark.parametrize(
    "lens",
    [FISHEYE, BEHIND, replace(LENSES["plumb_bob"], width=80)],
    ids=["fisheye", "behind", "plumb_bob"],
)
@pytest.mark.parametrize("size", [1.0, 0.15])
def test_each_pixel_sees_along_its_own_ray(lens: Lens, size: float) -> None:
    """Against brute force over all splats and pixels, which knows no faces and no bounds.

    Small splats lie between the centres of the pinhole pictures' pixels.
    """
    splats = cloud(Model.RAY)[:200]
    splats.scales[:] *= size
    warp = Warp(lens)
    rays = lens.rays(pixels_of(lens))
    eye = np.eye(4) if lens.is_fisheye else EYE  # from within, splats are all around
    picture = take_picture(CpuRenderer(splats), warp, eye, depth="expected")
    rgba, depth = along_rays(splats, eye, rays, behind=lens is BEHIND)
    assert decibels(picture.colour, rgba[..., :3]) >= 70
    assert rgba[..., 3].max() > 0.5  # there was something to see
    assert picture.depth is not None
    solid = (rgba[..., 3] > 0.6) & (rays[..., 2] > 0)
    assert np.median(np.abs(picture.depth - depth)[solid]) < 1e-3  # [m]


def test_only_rays_and_discs_are_drawn_by_samples() -> None:
    warp = Warp(FISHEYE)
    camera = posed(warp.cameras(np.eye(4), 0.01, 1e3)[0])
    with pytest.raises(RuntimeError, match="only Ray and Disc are drawn by samples, not EWA"):
        CpuRenderer(cloud()).draw(camera, samples=warp.samples[0])


@pytest.mark.parametrize("model", [Model.EWA, Model.EWA_ANTIALIASED])
@pytest.mark.parametrize(
    "lens",
    [
        FISHEYE,
        BEHIND,
        replace(LENSES["equidistant"], cx=100.2, cy=180.7),
        replace(LENSES["double_sphere"], fx=90.0, fy=90.0),
        replace(LENSES["ftheta"], fx=150.0, fy=150.0),
    ],
    ids=["fisheye", "behind", "off-centre", "double_sphere", "ftheta"],
)
def test_ellipses_are_projected_by_the_lens(lens: Lens, model: Model) -> None:
    """Against the reference, which differentiates the lens itself."""
    splats = cloud(model)
    warp = Warp(lens)
    ((camera, curve),) = warp.sheets(model).cameras(np.eye(4), 0.01, 1e10)
    assert curve
    behind = curve.by_distance
    eye = np.eye(4) if behind else EYE  # from within, splats are all around
    picture = take_picture(CpuRenderer(splats), warp, eye, depth="expected")
    camera = replace(camera, world_to_camera=eye)
    expected = reference.render(splats, camera, lens=lens, by_distance=behind)
    colour = np.where(warp.met[..., None], expected.rgba[..., :3], 0)
    assert decibels(picture.colour, colour) >= 75
    assert expected.rgba[..., 3].max() > 0.5  # there was something to see
    assert picture.depth is not None
    solid = (expected.rgba[..., 3] > 0.51) & (expected.depth > 0.01) & warp.met
    close = np.isclose(picture.depth[solid], expected.depth[solid], rtol=1e-3, atol=1e-3)
    assert close.mean() > 0.998
    assert not np.isfinite(picture.depth[expected.rgba[..., 3] < 0.49]).any()


def test_contributions_through_a_lens_add_up_to_its_picture() -> None:
    renderer = CpuRenderer(cloud())
    ((camera, curve),) = Warp(FISHEYE).sheets(Model.EWA).cameras(EYE, 0.01, 1e3)
    sums = Contributions()
    renderer.contribute(posed(camera), sums, lens=curve)
    alpha = renderer.draw(posed(camera), lens=curve)["colour"][..., 3]
    assert sums.weight.sum() == pytest.approx(alpha.sum(), rel=0.02)  # less what is below 0.01


def test_only_ellipses_are_drawn_by_a_curve() -> None:
    ((camera, curve),) = Warp(FISHEYE).sheets(Model.EWA).cameras(np.eye(4), 0.01, 1e3)
    with pytest.raises(RuntimeError, match="only EWA is drawn by a lens's curve, not Ray"):
        CpuRenderer(cloud(Model.RAY)).draw(posed(camera), lens=curve)
    opaque = np.ones((64, 64), np.float32)
    with pytest.raises(ValueError, match="a picture has one of samples, lens and scene_depth"):
        CpuRenderer(cloud()).draw(posed(camera), lens=curve, scene_depth=opaque)


PANORAMA = Lens(240, 120, 120 / math.pi, 120 / math.pi, 119.5, 59.5, "equirectangular")


def test_a_panorama_sees_along_its_rays_all_around() -> None:
    splats = cloud(Model.RAY)[:200]
    splats.scales[:] = np.maximum(splats.scales, 0.03)
    rays = PANORAMA.rays(pixels_of(PANORAMA))
    np.testing.assert_allclose(PANORAMA.project(rays), pixels_of(PANORAMA), atol=1e-9)
    picture = take_picture(CpuRenderer(splats), Warp(PANORAMA), np.eye(4))
    rgba, _ = along_rays(splats, np.eye(4), rays, behind=True)
    assert decibels(picture.colour, rgba[..., :3]) >= 70


@pytest.mark.parametrize("model", [Model.EWA, Model.RAY, Model.DISC], ids=str)
def test_a_panorama_has_no_seam_behind_and_no_hole_at_the_poles(model: Model) -> None:
    """Turned around, it is the same picture moved by half of its width."""
    splats = cloud(model)
    splats.positions[:] *= 3 / np.linalg.norm(splats.positions, axis=1, keepdims=True)
    splats.scales[:] = np.maximum(splats.scales, 0.3)
    renderer = CpuRenderer(splats)
    poles = replace(PANORAMA, height=121, cy=60.0)  # its first and last rows are the poles
    ahead, behind = (
        take_picture(renderer, Warp(poles), np.diag([turn, 1.0, turn, 1.0]), alpha=True).colour
        for turn in (1.0, -1.0)
    )
    assert np.isfinite(ahead).all() and ahead[[0, -1], :, 3].max() > 0.1
    assert decibels(np.roll(behind, PANORAMA.width // 2, axis=1), ahead) >= 70
    # Each of these rows is one point; ellipses' two pictures meet there.
    assert np.ptp(ahead[[0, -1]], axis=1).max() < (0.1 if model is Model.EWA else 1e-3)


@pytest.mark.parametrize(
    "lens",
    [PANORAMA, replace(FISHEYE, fx=12.0, fy=12.0), replace(LENSES["plumb_bob"], fx=120.0)],
    ids=["panorama", "all around", "wide"],
)
def test_ellipses_of_a_wide_lens_have_no_seams(lens: Lens) -> None:
    """Splats all around look much as along the rays: by the faces of a cube, to 22 to 25 dB."""
    splats = cloud()
    splats.positions[:] *= 3 / np.linalg.norm(splats.positions, axis=1, keepdims=True)
    splats.scales[:] = np.random.default_rng(6).uniform(0.2, 0.4, (len(splats), 1))
    warp = Warp(lens)
    assert len(warp.cameras(np.eye(4), 0.01, 1e3)) > 2
    renderer = CpuRenderer(splats)
    eye = look_at((0.1, 0.0, 0.0), (1.0, 0.0, 0.0))
    ellipses = take_picture(renderer, warp, eye).colour
    renderer.settings.model = int(Model.RAY)
    rays = take_picture(renderer, warp, eye).colour
    assert decibels(ellipses, rays) >= 30
