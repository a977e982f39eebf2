"""Kinds of files by the ending of their name; the readers and writers load what each kind needs."""

from __future__ import annotations

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
CLOUD_ENDINGS = (*ENCODINGS, ".e57")
#: Meshes: endings that are written, and those that are read.
ENDINGS = (".ply", ".obj", ".stl", ".off")
LANDXML = (".xml", ".landxml")
READ_ENDINGS = (*ENDINGS, *LANDXML)
