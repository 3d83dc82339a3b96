"""Files that are taken for scenes, by how they begin: named as what they are."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

LFS = b"version https://git-lfs.github.com/spec/"
MARKUP = (b"<!doctype", b"<html", b"<?xml", b"<head", b"<error")
GZIP, ZIP = b"\x1f\x8b\x08", b"PK\x03\x04"
PACKED = {
    GZIP: "packed by gzip", b"BZh": "packed by bzip2", b"\xfd7zXZ": "packed by xz",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive", b"Rar!": "a RAR archive",
    b"\x28\xb5\x2f\xfd": "packed by Zstandard",
}  # fmt: skip
EXPORT = "have its trainer export a PLY"
BAG = "a bag of ROS: play it, and `follow` hears the maps in it"
OTHERS = {
    b"LASF": "a point cloud (LAS), not of splats",
    b"# .PCD": "a point cloud (PCD), not of splats",
    b"ASTM-E57": "a point cloud (E57), not of splats",
    b"\x89HDF": f"HDF5: {EXPORT}",
    b"\x93NUMPY": "an array of NumPy",
    b"\x89MCAP": BAG, b"SQLite format 3": BAG, b"#ROSBAG": BAG,
    **{
        bytes([0x80, protocol]): f"a pickle of Python, a checkpoint perhaps: {EXPORT}"
        for protocol in (2, 3, 4, 5)
    },
}  # fmt: skip
LCC = (".lcc", ".lcc2")  # XGRIDS'
PICTURES = (b"\x89PNG", b"\xff\xd8\xff", b"RIFF")
MOST_NAMES = 3
LONGEST_LINE = 60  # of a text that is quoted [characters]


def impostor(head: bytes) -> str:
    """What stands in the place of a file of any ending; empty for none."""
    if head.startswith(LFS):
        return "a pointer of Git LFS, not the file itself: `git lfs pull` fetches it"
    if head.lstrip(b"\xef\xbb\xbf \t\r\n")[:16].lower().startswith(MARKUP):
        return "a web page, not the file itself: what a download got in its place"
    return ""


def packed(head: bytes) -> bool:
    """Whether a file is an archive, or packed by a program that packs any file; or text."""
    return head.startswith((ZIP, *PACKED)) or bool(_text(head))


def _text(head: bytes) -> str:
    """The first line of a file of text, as most programs write it; empty for any other."""
    wide = head.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        lines = head.decode("utf-16" if wide else "utf-8-sig").split()
    except UnicodeDecodeError:
        return ""
    return " ".join(lines)[:LONGEST_LINE] if all(map(str.isprintable, lines)) else ""


def stranger(path: Path, head: bytes) -> str:
    """What a file is that no format recognises; empty for what isn't known."""
    if head.startswith(ZIP):
        return _zip(path)
    if head.startswith(GZIP) and beginning(head, 4) in (b"ply\n", b"ply\r"):
        return "a PLY packed by gzip: unpack it first"
    for first, what in PACKED.items():
        if head.startswith(first):
            return f"{what}: unpack it first"
    for first, what in OTHERS.items():
        if head.startswith(first):
            return what
    if path.suffix.lower() in LCC:
        return "LCC of XGRIDS, which isn't read: splat-transform makes another format of it"
    if head[257:262] == b"ustar":
        return "a tar archive: unpack it first"
    if head.startswith(PICTURES):
        return "a picture"
    if head.lstrip()[:1] in (b"{", b"["):
        return "JSON, and no scene in it is known"
    if text := _text(head):
        if text.startswith("ply"):
            return "a PLY in another text than ASCII: save it as that, without a byte order mark"
        return f"not a scene, but text that begins '{text}'"
    return ""


def beginning(packed: bytes, count: int) -> bytes:
    """The first bytes of what gzip has packed, given its own first ones; empty for damaged ones."""
    try:
        return zlib.decompressobj(16 + zlib.MAX_WBITS).decompress(packed, count)
    except zlib.error:
        return b""


def _zip(path: Path) -> str:
    """What a zip is, by its files."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return "a zip that is cut short or damaged"
    if any(name.endswith("data.pkl") for name in names):
        return f"a checkpoint of PyTorch: {EXPORT}"
    scenes = [name for name in names if name.lower().endswith((".ply", ".splat", ".spz", ".sog"))]
    shown = ", ".join((scenes or names)[:MOST_NAMES]) + ", …" * (len(scenes or names) > MOST_NAMES)
    return f"a zip with {shown or 'nothing'}: unpack it first"
