"""Kinds of files by the ending of their name; the readers and writers load what each kind needs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

#: Point clouds: ending → encodings that can be written, the default first.
ENCODINGS: dict[str, tuple[str, ...]] = {
    ".ply": ("binary", "ascii", "binary_big_endian"),
    ".pcd": ("binary", "ascii", "binary_compressed"),
    ".csv": ("csv",),
    ".xyz": ("text",),
    ".txt": ("text",),
    ".asc": ("text",),
    ".npy": ("npy",),
    ".las": ("las",),
    ".laz": ("laz",),
}
#: Point clouds that are read.
CLOUD_ENDINGS = (*ENCODINGS, ".pts", ".e57", ".tif", ".tiff")
#: Meshes: endings that are written, and those that are read.
ENDINGS = (".ply", ".obj", ".stl", ".off")
LANDXML = (".xml", ".landxml")
READ_ENDINGS = (*ENDINGS, *LANDXML, ".dxf")


def unknown_cloud(path: Path, kinds: Iterable[str] = CLOUD_ENDINGS) -> str:
    """What to say of a point cloud file whose ending is none of these."""
    ending = path.suffix.lower() or "no ending"
    return f"{path}: {ending} is no known kind of point cloud file ({', '.join(kinds)})"
