"""SOG: folders and zips decode as the specification says, and bad metadata is named by field."""

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rosplat_core.formats import InputError, load, save
from rosplat_core.models import Model
from rosplat_core.splats import Splats

COUNT = 6  # in pictures of 4 x 2 pixels, so that two stay unused


def write_scene(folder: Path, bands: int = 1) -> dict[str, Any]:
    """A scene of random bytes; returns its metadata."""
    rng = np.random.default_rng(bands)
    folder.mkdir(exist_ok=True)
    coefficients = (bands + 1) ** 2 - 1
    quats = rng.integers(60, 200, (2, 4, 4))
    quats[..., 3] = rng.integers(252, 256, (2, 4))
    labels = np.zeros((2, 4, 4))
    labels[..., 0] = rng.integers(0, 100, (2, 4))
    pictures = {
        "means_l": rng.integers(0, 256, (2, 4, 4)),
        "means_u": rng.integers(0, 256, (2, 4, 4)),
        "quats": quats,
        "scales": rng.integers(0, 256, (2, 4, 3)),
        "sh0": rng.integers(0, 256, (2, 4, 4)),
        "centroids": rng.integers(0, 256, (2, 64 * coefficients, 3)),
        "labels": labels,
    }
    for name, pixels in pictures.items():
        Image.fromarray(pixels.astype(np.uint8)).save(
            folder / f"{name}.webp", lossless=True, exact=True
        )
    meta: dict[str, Any] = {
        "version": 2,
        "count": COUNT,
        "means": {
            "mins": [-2, -1, 0],
            "maxs": [1, 2, 3],
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": list(np.linspace(-9, -2, 256)), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": list(np.linspace(-3, 3, 256)), "files": ["sh0.webp"]},
        "shN": {
            "count": 128,
            "bands": bands,
            "codebook": list(np.linspace(-1, 1, 256)),
            "files": ["centroids.webp", "labels.webp"],
        },
    }
    (folder / "meta.json").write_text(json.dumps(meta))
    return meta


def pixel(folder: Path, name: str, index: int, width: int = 4) -> list[int]:
    with Image.open(folder / f"{name}.webp") as image:
        return list(image.convert("RGBA").getpixel((index % width, index // width)))  # type: ignore[arg-type]


@pytest.mark.parametrize("bands", [1, 2, 3])
def test_each_splat_decodes_by_the_specification(tmp_path: Path, bands: int) -> None:
    meta = write_scene(tmp_path, bands)
    splats = load(tmp_path)
    assert (len(splats), splats.sh_degree) == (COUNT, bands)
    for i in range(COUNT):
        low, high = pixel(tmp_path, "means_l", i), pixel(tmp_path, "means_u", i)
        for axis in range(3):
            lowest, highest = meta["means"]["mins"][axis], meta["means"]["maxs"][axis]
            value = lowest + (highest - lowest) * (256 * high[axis] + low[axis]) / 65535
            expected = np.sign(value) * (np.exp(abs(value)) - 1)
            assert splats.positions[i, axis] == pytest.approx(expected, abs=1e-6)
            code = pixel(tmp_path, "scales", i)[axis]
            assert np.log(splats.scales[i, axis]) == pytest.approx(-9 + 7 * code / 255, abs=1e-5)
        *stored, tag = pixel(tmp_path, "quats", i)
        wxyz = [(value / 255 * 2 - 1) / np.sqrt(2) for value in stored]
        wxyz.insert(tag - 252, np.sqrt(1 - np.square(wxyz).sum()))
        np.testing.assert_allclose(splats.orientations[i], np.roll(wxyz, -1), atol=1e-6)
        *color, opacity = pixel(tmp_path, "sh0", i)
        np.testing.assert_allclose(splats.sh[i, 0], np.array(color) / 255 * 6 - 3, atol=1e-5)
        assert splats.opacities[i] == pytest.approx(opacity / 255)
        label = pixel(tmp_path, "labels", i)[0]
        k = (bands + 1) ** 2 - 1
        for j in range(k):
            index = (label // 64) * 64 * k + (label % 64) * k + j
            code_rgb = pixel(tmp_path, "centroids", index, 64 * k)[:3]
            np.testing.assert_allclose(
                splats.sh[i, 1 + j], np.array(code_rgb) / 255 * 2 - 1, atol=1e-5
            )


def test_folder_meta_and_zip_are_one_scene(tmp_path: Path) -> None:
    write_scene(tmp_path / "a")
    with zipfile.ZipFile(tmp_path / "a.sog", "w") as bundle:
        for file in (tmp_path / "a").iterdir():
            bundle.write(file, file.name)
    scenes = [load(tmp_path / "a"), load(tmp_path / "a" / "meta.json"), load(tmp_path / "a.sog")]
    for scene in scenes[1:]:
        np.testing.assert_array_equal(scene.positions, scenes[0].positions)
        np.testing.assert_array_equal(scene.sh, scenes[0].sh)


@pytest.mark.parametrize("field", ["scales", "sh0", "shN"])
def test_a_codebook_that_begins_with_null_is_mended(tmp_path: Path, field: str) -> None:
    meta = write_scene(tmp_path)
    picture = tmp_path / meta[field]["files"][0]
    with Image.open(picture) as codes:
        size = codes.size
    Image.new("RGB", size).save(picture, lossless=True)  # the first value in all places
    book = meta[field]["codebook"]
    book[0] = None
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    read = load(tmp_path)
    numbers = {"scales": np.log(read.scales), "sh0": read.sh[:, 0], "shN": read.sh[:, 1:]}[field]
    np.testing.assert_allclose(numbers, book[1] + (book[1] - book[255]) / 255, rtol=1e-6)


def test_without_higher_bands(tmp_path: Path) -> None:
    meta = write_scene(tmp_path)
    del meta["shN"]
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    assert load(tmp_path).sh_degree == 0


def test_reserved_quaternion_tags_drop_their_splats(tmp_path: Path) -> None:
    write_scene(tmp_path)
    pixels = np.full((2, 4, 4), 253, np.uint8)
    pixels[0, 2, 3] = 17
    Image.fromarray(pixels).save(tmp_path / "quats.webp", lossless=True, exact=True)
    warnings: list[str] = []
    assert len(load(tmp_path, warn=warnings.append)) == COUNT - 1
    assert "dropped 1 of 6" in warnings[0]


@pytest.mark.parametrize(
    ("keys", "value", "reason"),
    [
        (["version"], [], r"SOG version \[\]"),
        (["version"], 3, "SOG version 3"),
        (["count"], "many", "count is 'many'"),
        (["count"], True, "count is True"),
        (["count"], 9, "means_l.webp holds 8 pixels, fewer than 9"),
        (["means", "mins"], [0, 0], r"means\.mins: expected 3"),
        (["means", "maxs"], [0, 0, None], r"means\.maxs: expected 3"),
        (["scales", "codebook"], [0.0] * 255, r"scales\.codebook: expected 256"),
        (["sh0", "codebook"], [None, None, *[0.0] * 254], r"sh0\.codebook: expected 256"),
        (["sh0", "codebook"], "no", r"sh0\.codebook: expected 256"),
        (["quats"], {}, r"no field quats\.files"),
        (["means", "files"], ["means_l.webp"], r"means\.files has no file name at 1"),
        (["means", "maxs"], [0, 0, 10**400], r"means\.maxs: expected 3"),
        (["sh0", "files"], ["none.webp"], "can't read 'none.webp': .*No such file"),
        (["sh0", "files"], ["none\0"], "not the name of a file beside"),
        (["sh0", "files"], ["../sh0.webp"], "not the name of a file beside"),
        (["count"], 40_000_000, "a map has at most"),
        (["count"], 30_000_000, "30,000,000 splats can't be packed in"),
        (["shN", "files"], ["means_l.webp", "labels.webp"], "means_l.webp is 4 px wide, not 192"),
        (["sh0", "files"], ["meta.json"], "meta.json is no picture"),
        (["shN", "bands"], 4, r"shN\.bands is 4"),
        (["shN", "bands"], 1.0, r"shN\.bands is 1\.0"),
        (["shN", "bands"], 2, "192 px wide, not 512"),
    ],
)
def test_bad_metadata(tmp_path: Path, keys: list[str], value: object, reason: str) -> None:
    meta = write_scene(tmp_path)
    target = meta
    for key in keys[:-1]:
        target = target[key]
    target[keys[-1]] = value
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(InputError, match=rf"meta\.json: .*{reason}"):
        load(tmp_path)


def test_labels_beyond_the_palette(tmp_path: Path) -> None:
    write_scene(tmp_path)
    Image.fromarray(np.full((2, 4, 4), 200, np.uint8)).save(
        tmp_path / "labels.webp", lossless=True, exact=True
    )
    with pytest.raises(InputError, match="label 51400, but 128 centroids"):
        load(tmp_path)


@pytest.mark.parametrize("text", ["{", "[]", "3", "\udcff", "[" * 100_000])
def test_broken_json(tmp_path: Path, text: str) -> None:
    (tmp_path / "meta.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=r"meta\.json: "):
        load(tmp_path)


def test_broken_zip(tmp_path: Path) -> None:
    (tmp_path / "a.sog").write_bytes(b"PK\x03\x04 and nothing more")
    with pytest.raises(InputError, match=r"a\.sog: broken or truncated zip"):
        load(tmp_path / "a.sog")


def test_damaged_and_huge_files_in_a_zip(tmp_path: Path) -> None:
    write_scene(tmp_path / "a")
    path = tmp_path / "a.sog"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bundle:
        for file in (tmp_path / "a").iterdir():
            bundle.write(file, file.name)
        place = bundle.getinfo("meta.json").header_offset + 30 + len("meta.json")
    whole = path.read_bytes()
    path.write_bytes(whole[:place] + b"\xff\xff" + whole[place + 2 :])
    with pytest.raises(InputError, match=r"a\.sog: can't read 'meta\.json': .*decompressing"):
        load(path)
    for method in (zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2):
        with zipfile.ZipFile(path, "w", method) as bundle:
            bundle.write(tmp_path / "a" / "meta.json", "meta.json")
        with pytest.raises(InputError, match=r"can't read 'meta\.json': compression method"):
            load(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as bundle:
        bundle.writestr("meta.json", b" " * (1 << 25))  # a bomb
    with pytest.raises(InputError, match=r"can't read 'meta\.json': 33,554,432 bytes, in 32,"):
        load(path)


def test_pictures_far_larger_than_the_scene(tmp_path: Path) -> None:
    write_scene(tmp_path)
    Image.new("RGBA", (4096, 4096)).save(tmp_path / "scales.webp", lossless=True)
    assert (tmp_path / "scales.webp").stat().st_size < 10_000
    with pytest.raises(InputError, match=r"scales\.webp holds 16,777,216 pixels for 6 splats"):
        load(tmp_path)


def test_version_1_decodes_as_splat_transform_reads_it(tmp_path: Path) -> None:
    meta = write_scene(tmp_path, 2)
    mins, maxs = [-1.0, -2.0, -3.0, -4.0], [1.0, 2.0, 3.5, 5.0]
    del meta["version"], meta["count"]
    meta["means"]["shape"] = [COUNT, 3]
    meta["scales"] = {"mins": mins[:3], "maxs": maxs[:3], "files": ["scales.webp"]}
    meta["sh0"] = {"mins": mins, "maxs": maxs, "files": ["sh0.webp"]}
    meta["shN"] = {"mins": -0.5, "maxs": 1.5, "files": meta["shN"]["files"]}
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    splats = load(tmp_path)
    assert (len(splats), splats.sh_degree) == (COUNT, 2)
    for i in range(COUNT):
        logarithms = [
            mins[axis] + (maxs[axis] - mins[axis]) * code / 255
            for axis, code in enumerate(pixel(tmp_path, "scales", i)[:3])
        ]
        np.testing.assert_allclose(np.log(splats.scales[i]), logarithms, atol=1e-5)
        *color, logit = (
            mins[channel] + (maxs[channel] - mins[channel]) * code / 255
            for channel, code in enumerate(pixel(tmp_path, "sh0", i))
        )
        np.testing.assert_allclose(splats.sh[i, 0], color, atol=1e-5)
        assert splats.opacities[i] == pytest.approx(1 / (1 + np.exp(-logit)), abs=1e-6)
        label = pixel(tmp_path, "labels", i)[0]
        index = (label // 64) * 64 * 8 + (label % 64) * 8 + 5
        code_rgb = pixel(tmp_path, "centroids", index, 64 * 8)[:3]
        np.testing.assert_allclose(splats.sh[i, 6], np.array(code_rgb) / 255 * 2 - 0.5, atol=1e-5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("model", Model)
def test_round_trip(
    random_splats: Callable[..., Splats], tmp_path: Path, degree: int, model: Model
) -> None:
    splats = random_splats(700, degree, model=model)
    splats.sh[:, 1:] *= 0.1
    splats.opacities[:2] = 0, 1  # colours stay under alpha 0
    written = save(tmp_path / "a.sog", splats)
    back = load(tmp_path / "a.sog")
    assert back.model is model
    np.testing.assert_allclose(back.positions, written.positions, atol=5e-4)
    tiny = np.finfo(np.float32).tiny  # stands for a disc's third scale
    np.testing.assert_allclose(
        np.log(back.scales), np.log(np.maximum(written.scales, tiny)), atol=0.05
    )
    np.testing.assert_allclose(back.opacities, written.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(back.sh[:, 0], written.sh[:, 0], atol=0.2)
    cosine = np.abs((back.orientations * written.orientations).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < 1
    # 512 vectors stand for 700.
    assert np.abs(back.sh - written.sh).mean() < 0.05


@pytest.mark.parametrize(
    ("word", "model"),
    [("2dgs", Model.DISC), ("disc", Model.DISC), ("antialiased", Model.EWA_ANTIALIASED)],
)
def test_words_for_models_are_splat_transform_s_and_ours(
    random_splats: Callable[..., Splats], tmp_path: Path, word: str, model: Model
) -> None:
    meta = write_scene(tmp_path)
    (tmp_path / "meta.json").write_text(json.dumps(meta | {"model": word}))
    assert load(tmp_path).model is model
    save(tmp_path / "a.sog", random_splats(9, model=model))
    with zipfile.ZipFile(tmp_path / "a.sog") as bundle:
        told = json.loads(bundle.read("meta.json"))["model"]
    assert told == ("2dgs" if model is Model.DISC else "antialiased")


@pytest.mark.parametrize("count", [0, 1, 5])
def test_small_scenes_are_written(
    random_splats: Callable[..., Splats], tmp_path: Path, count: int
) -> None:
    written = save(tmp_path / "a.sog", random_splats(count))
    back = load(tmp_path / "a.sog")
    np.testing.assert_allclose(back.positions, written.positions, atol=1e-4)
    assert len(back) == count


def test_a_streamed_scene_without_its_files(scene: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"0_0/meta\.json: can't read"):
        load(scene("playbot") / "lod-meta.json")
    for text in ("{", "[]", '{"lodLevels": 3}', '{"lodLevels": "x", "filenames": []}', "[" * 10**5):
        (tmp_path / "lod-meta.json").write_text(text)
        with pytest.raises(InputError, match=r"lod-meta\.json: broken"):
            load(tmp_path)


@pytest.mark.parametrize("value", [0.0, 1e19, 3e38])
def test_one_large_number_everywhere(
    random_splats: Callable[..., Splats], tmp_path: Path, value: float
) -> None:
    splats = random_splats(300)
    splats.sh[:] = value
    save(tmp_path / "a.sog", splats)
    np.testing.assert_allclose(load(tmp_path / "a.sog").sh, splats.sh, rtol=1e-6)


def test_no_scene_at_all(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_bytes(b"\0no scene")
    os.mkfifo(tmp_path / "pipe.ply")
    for path, reason in [
        (
            "notes.txt",
            r"not a scene .* \(compressed PLY, PLY, SPZ, .*SOG, .*tiles\)",
        ),
        ("pipe.ply", "not a file"),
        ("a\0b.ply", "no name of a file"),
        ("n" * 300, "File name too long"),
        ("none", "No such file"),
        (".", "not a scene"),
    ]:
        with pytest.raises(InputError, match=reason):
            load(tmp_path / path)


def test_a_trained_scene(scene: Callable[[str], Path], tmp_path: Path) -> None:
    splats = load(scene("playbot"))
    assert (len(splats), splats.sh_degree) == (500_000, 2)
    save(tmp_path / "playbot.ply", splats)
    np.testing.assert_array_equal(load(tmp_path / "playbot.ply").sh, splats.sh)
