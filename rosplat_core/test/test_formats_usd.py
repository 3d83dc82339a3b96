"""OpenUSD: arrays lie as ParticleField3DGaussianSplat has them, in metres, where prims stand.

Where usd-core is installed: pip install usd-core
"""

import importlib.util
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core.formats import InputError, axes, load, save
from rosplat_core.models import Model
from rosplat_core.splats import Splats

lacking = importlib.util.find_spec("pxr") is None
pytestmark = pytest.mark.skipif(lacking, reason="no usd-core (PyPI)")

Make = Callable[..., Splats]

ENDINGS = (".usda", ".usdc", ".usdz", ".usd")
BY_HAND = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.5
    upAxis = "Y"
)
def Xform "World"
{
    double3 xformOp:translate = (10, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def ParticleField3DGaussianSplat "Splats"
    {
        point3f[] positions = [(1, -2, 3), (4, 5, 6)]
        quatf[] orientations = [(0, 0, -1, 0), (2, 0, 0, 0)]
        float3[] scales = [(0.5, 0.25, 2), (1, 1, 1)]
        half[] opacitiesh = [0.75, 0.5]
        int radiance:sphericalHarmonicsDegree = 1
        float3[] radiance:sphericalHarmonicsCoefficients = [
            (0.1, 0.2, 0.3), (1, 2, 3), (4, 5, 6), (7, 8, 9),
            (0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 1)]
    }
}
"""


def test_splats_by_hand(tmp_path: Path) -> None:
    (tmp_path / "a.usda").write_text(BY_HAND)
    splats = load(tmp_path / "a.usda")
    np.testing.assert_array_equal(splats.positions, [[5.5, -1, 1.5], [7, 2.5, 3]])
    np.testing.assert_array_equal(splats.orientations, [[0, -1, 0, 0], [0, 0, 0, 1]])
    np.testing.assert_array_equal(splats.scales, [[0.25, 0.125, 1], [0.5, 0.5, 0.5]])
    np.testing.assert_array_equal(splats.opacities, [0.75, 0.5])
    np.testing.assert_array_equal(
        splats.sh[0], np.float32([[0.1, 0.2, 0.3], [1, 2, 3], [4, 5, 6], [7, 8, 9]])
    )
    assert axes(tmp_path / "a.usda").up == (0, 1, 0)


@pytest.mark.parametrize("ending", ENDINGS)
def test_round_trip(random_splats: Make, tmp_path: Path, ending: str) -> None:
    for degree in (0, 3):
        splats = random_splats(2000, degree, model=Model(degree))
        path = tmp_path / f"a{degree}{ending}"
        save(path, splats)
        back = load(path)
        for name in ("positions", "scales", "opacities", "sh", "model"):
            np.testing.assert_array_equal(getattr(back, name), getattr(splats, name))
        np.testing.assert_allclose(back.orientations, splats.orientations, atol=2e-7)
    assert {path.name for path in tmp_path.iterdir()} == {f"a0{ending}", f"a3{ending}"}


def test_a_far_map_keeps_its_millimetres(random_splats: Make, tmp_path: Path) -> None:
    splats = replace(random_splats(100), origin=np.array([3e6, 0, -5e5]))
    save(tmp_path / "a.usdc", splats)
    back = load(tmp_path / "a.usdc")
    moved = back.positions + (back.origin - splats.origin) - splats.positions
    np.testing.assert_allclose(moved, 0, atol=1e-5)


@pytest.mark.parametrize(
    ("up", "written"),
    [(None, "Z"), ((0.0, 0.0, 1.0), "Z"), ((0.0, 1.0, 0.0), "Y"), ((0.0, -1.0, 0.0), "Z")],
)
def test_the_stage_tells_up_and_metres(
    random_splats: Make, tmp_path: Path, up: tuple[float, float, float] | None, written: str
) -> None:
    from pxr import Usd, UsdGeom

    save(tmp_path / "a.usda", replace(random_splats(3), up=up))
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == written
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert axes(tmp_path / "a.usda").up == ((0, 1, 0) if written == "Y" else (0, 0, 1))
    turned = replace(random_splats(3), up=(0.0, 1.0, 0.0))
    save(tmp_path / "a.usda", turned, overwrite=True)
    assert axes(tmp_path / "a.usda").up == (0, 1, 0)  # not what was there before


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("count", [0, 50])
def test_usd_core_s_own_validation(
    random_splats: Make, tmp_path: Path, ending: str, count: int
) -> None:
    from pxr import Usd, UsdValidation, UsdVol

    save(tmp_path / f"a{ending}", replace(random_splats(count), origin=np.array([100.0, 0, 0])))
    stage = Usd.Stage.Open(str(tmp_path / f"a{ending}"))
    registry = UsdValidation.ValidationRegistry()
    validators = [
        registry.GetOrLoadValidatorByName(known.name)
        for known in registry.GetAllValidatorMetadata()
    ]
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetMessage() for error in found] == []
    prim = stage.GetDefaultPrim()
    assert prim.IsA(UsdVol.ParticleField3DGaussianSplat)
    schema = prim.GetPrimDefinition()
    for attribute in prim.GetAuthoredAttributes():
        if attribute.GetName().startswith("xformOp:"):
            continue
        meant = schema.GetAttributeDefinition(attribute.GetName())
        assert meant, attribute.GetName()
        assert attribute.GetTypeName() == meant.GetTypeName()
        assert attribute.GetVariability() == meant.GetVariability()


def test_the_extent_holds_three_sigma(random_splats: Make, tmp_path: Path) -> None:
    from pxr import Usd

    splats = random_splats(50)
    save(tmp_path / "a.usdc", splats)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    low, high = np.array(stage.GetDefaultPrim().GetAttribute("extent").Get())
    reach = 3 * splats.scales.max(axis=1, keepdims=True)
    assert (low <= splats.positions - reach).all()
    assert (high >= splats.positions + reach).all()


def test_what_a_prim_has_not(tmp_path: Path) -> None:
    """The schema's: no rotation, scale 1, opaque, grey; rows too many are cut, too few ignored."""
    (tmp_path / "a.usda").write_text(
        '#usda 1.0\n(metersPerUnit = 1)\ndef ParticleField3DGaussianSplat "A" {\n'
        "point3f[] positions = [(1, 2, 3), (4, 5, 6)]\nfloat[] opacities = [0.5, 0.25, 1]\n"
        "float3[] scales = [(1, 2, 3)]\n}\n"
        'def ParticleField3DGaussianSplat "B" {\npoint3h[] positionsh = [(7, 8, 9)]\n}\n'
        'def ParticleField3DGaussianSplat "C" {\n}\ndef Mesh "D" {\n}\n'
    )
    splats = load(tmp_path / "a.usda")
    np.testing.assert_array_equal(splats.positions, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    np.testing.assert_array_equal(splats.opacities, [0.5, 0.25, 1])
    np.testing.assert_array_equal(splats.scales, np.ones((3, 3)))
    np.testing.assert_array_equal(splats.orientations, [[0, 0, 0, 1]] * 3)
    assert splats.sh.shape == (3, 1, 3)
    assert not splats.sh.any()


def test_what_is_drawn_in_another_way_is_told(tmp_path: Path) -> None:
    text = BY_HAND.replace("metersPerUnit = 0.5", "").replace(
        "point3f[]", 'uniform token sortingModeHint = "rayHitDistance"\npoint3f[]'
    )
    (tmp_path / "a.usda").write_text(text)
    warned: list[str] = []
    splats = load(tmp_path / "a.usda", warn=warned.append)
    assert "sortingModeHint is rayHitDistance; drawn as zDepth" in warned[0]
    assert "centimetres" in warned[1]
    np.testing.assert_allclose(splats.positions[0], [0.11, -0.02, 0.03], rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("#usda 1.0\ndef X {", "line 2:"),
        ("#usda 1.0\ndef \udcff {", "not in UTF-8"),
        ('#usda 1.0\ndef Mesh "A" {}\n', "holds no ParticleField3DGaussianSplat"),
        (
            "#usda 1.0\n(subLayers = [@/etc/passwd@])\n",
            "sublayer names another file, /etc",
        ),
        ('#usda 1.0\ndef "A" (references = @b.usda@) {}\n', "references of /A names another file"),
        ('#usda 1.0\ndef "A" (payload = @b.usda@) {}\n', "payload of /A names another file"),
        (
            '#usda 1.0\ndef "A" (variantSets = "v") {\nvariantSet "v" = {\n"w" {\n'
            'def "B" (references = @b.usda@) {}\n}\n}\n}\n',
            "references of /A{v=w}B names another file",
        ),
        ('#usda 1.0\ndef "A" (clips = {dictionary x = {}}) {}\n', "/A has value clips"),
        (
            '#usda 1.0\ndef Volume "A" {\nbool omni:nurec:isNuRecVolume = 1\n}\n',
            "a NuRec volume, which only Omniverse draws",
        ),
        (BY_HAND.replace("Degree = 1", "Degree = -1"), "SH degree -1"),
        (BY_HAND.replace("(10, 0, 0)", "(inf, 0, 0)"), "not finite"),
        (BY_HAND.replace("metersPerUnit = 0.5", "metersPerUnit = nan"), "not finite"),
        (
            BY_HAND.replace("half[] opacitiesh", "half3[] opacitiesh").replace(
                "[0.75, 0.5]", "[(1, 1, 1)]"
            ),
            "opacities of /World/Splats isn't an array",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "a.usda").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(InputError, match=rf"a\.usda: .*{reason}") as error:
        load(tmp_path / "a.usda")
    assert len(str(error.value)) < 1000


def test_a_claim_ends_usd_core_alone(tmp_path: Path) -> None:
    """Zeros take next to nothing in a .usdc, but four bytes each once they are read."""
    from pxr import Sdf, Usd, Vt

    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usdc"))
    prim = stage.DefinePrim("/A", "ParticleField3DGaussianSplat")
    zeros = Vt.FloatArray.FromNumpy(np.zeros(1 << 26, np.float32))
    prim.CreateAttribute("opacities", Sdf.ValueTypeNames.FloatArray, False).Set(zeros)
    stage.Save()
    assert (tmp_path / "a.usdc").stat().st_size < 100_000
    with pytest.raises(InputError, match=r"a\.usdc: .*(claims more memory|unpacking)"):
        load(tmp_path / "a.usdc")


def test_whoever_waits_may_give_up(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.usda", random_splats(20_000))

    def give_up(fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        load(tmp_path / "a.usda", progress=give_up)


def packaged(path: Path, layers: dict[str, str]) -> Path:
    """A .usdz of layers in text, the first of which is what is opened."""
    from pxr import Sdf

    package = Sdf.ZipFileWriter.CreateNew(str(path))
    for name, text in layers.items():
        (path.parent / "layer.usda").write_text(text)
        package.AddFile(str(path.parent / "layer.usda"), name)
    package.Save()
    return path


ROOT = '#usda 1.0\n(upAxis = "Z"\nmetersPerUnit = 1)\n'


@pytest.mark.parametrize(
    "root",
    [
        'over "World" (references = @splats.usda@) {}\n',  # as 3DGRUT writes it
        'def "World" (prepend payload = @./splats.usda@</World>) {}\n',
        'def "World" (variants = {string v = "w"}\nprepend variantSets = "v") {\n'
        'variantSet "v" = {\n"w" (references = @splats.usda@) {}\n}\n}\n',
        'def "World" (references = @middle.usda@</Between>) {}\n',
    ],
)
def test_layers_of_a_package_refer_to_one_another(tmp_path: Path, root: str) -> None:
    middle = '#usda 1.0\ndef "Between" (references = @splats.usda@) {}\n'
    layers = {"default.usda": ROOT + root, "splats.usda": BY_HAND, "middle.usda": middle}
    splats = load(packaged(tmp_path / "a.usdz", layers))
    np.testing.assert_array_equal(splats.positions, [[11, -2, 3], [14, 5, 6]])
    assert splats.up == (0, 0, 1)


def test_parts_of_a_file_refer_to_one_another(tmp_path: Path) -> None:
    text = ROOT + BY_HAND.partition(")\n")[2] + 'def "Again" (references = </World>) {}\n'
    (tmp_path / "a.usda").write_text(text)
    np.testing.assert_array_equal(
        load(tmp_path / "a.usda").positions, 2 * [[11, -2, 3], [14, 5, 6]]
    )


def test_a_package_is_not_left(tmp_path: Path) -> None:
    (tmp_path / "splats.usda").write_text(BY_HAND)
    for asset, reason in (
        (str(tmp_path / "splats.usda"), "names another file"),
        ("./splats.usda", "names ./splats.usda, which the package lacks"),
        ("../splats.usda", "which the package lacks"),
        ("splats.usda", "names another file"),
    ):
        root = f'{ROOT}def "World" (references = @{asset}@) {{}}\n'
        with pytest.raises(InputError, match=reason):
            load(packaged(tmp_path / "a.usdz", {"default.usda": root}))


def test_a_package_holds_a_layer_as_it_is(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.usdz", random_splats(3))
    with zipfile.ZipFile(tmp_path / "a.usdz") as package:
        (entry,) = package.infolist()
    assert (entry.filename, entry.compress_type) == ("scene.usdc", zipfile.ZIP_STORED)


def test_trained_numbers_are_taken_for_what_they_are(random_splats: Make, tmp_path: Path) -> None:
    from pxr import Usd, Vt

    splats = random_splats(200)
    splats.opacities[:] = np.linspace(0.75, 0.99, 200)
    save(tmp_path / "a.usda", splats)
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    prim = stage.GetDefaultPrim()
    prim.GetAttribute("scales").Set(Vt.Vec3fArray.FromNumpy(np.log(splats.scales)))
    logits = np.log(splats.opacities / (1 - splats.opacities))
    prim.GetAttribute("opacities").Set(Vt.FloatArray.FromNumpy(logits))
    stage.Save()
    warned: list[str] = []
    found = load(tmp_path / "a.usda", warn=warned.append)
    assert [("logarithms" in text, "logits" in text) for text in warned] == [
        (True, False), (False, True),
    ]  # fmt: skip
    np.testing.assert_allclose(found.scales, splats.scales, rtol=1e-5)
    np.testing.assert_allclose(found.opacities, splats.opacities, atol=1e-6)
