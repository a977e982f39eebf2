"""Sizes within the chunks of a LAZ file, held against the chunk before they are unpacked.

From point format 6 on, a chunk holds its first point as it is, the number of its points and the
size of each layer, each in four bytes, and the layers. The decompressor allocates what the sizes
say. Layout: LASzip, items of version 3 and 4.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from ladar_volume.model.errors import CloudError

#: Layers of an item by its type: point, colours, colours and infrared, waveform; extra bytes have
#: one each.
LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
EXTRA_BYTES = 14
#: The packing in which chunks have layers.
LAYERED = 3
ITEM = struct.Struct("<HHH")


def check_layers(path: Path, first: int, packing: bytes) -> None:
    """Refuse chunks whose layers are larger than they.

    first : where the points begin · packing : record of the file that says how it is packed. Raises
    :class:`CloudError`.
    """
    items = list(ITEM.iter_unpack(packing[34 : 34 + len(packing[34:]) // 6 * 6]))
    if len(packing) < 34 or struct.unpack_from("<H", packing)[0] != LAYERED:
        return
    point_bytes = sum(size for _, size, _ in items)
    layers = sum(size if kind == EXTRA_BYTES else LAYERS.get(kind, 0) for kind, size, _ in items)
    head = point_bytes + 4 + 4 * layers
    with path.open("rb") as file:
        for at, held in chunks(path, first, packing):
            file.seek(at + point_bytes + 4)
            words = file.read(4 * layers)
            sizes = struct.unpack(f"<{len(words) // 4}I", words[: len(words) // 4 * 4])
            if len(sizes) < layers or head + sum(sizes) > held:
                raise CloudError(
                    f"a chunk of {held} bytes holds layers of {sum(sizes)}: damaged",
                    reason="cloud_values",
                    value=sum(sizes),
                )


def chunks(path: Path, first: int, packing: bytes) -> Iterator[tuple[int, int]]:
    """Place and size of each chunk, bytes."""
    import lazrs

    with path.open("rb") as file:
        file.seek(first)
        table = lazrs.read_chunk_table(file, lazrs.LazVlr(packing))
    at = first + 8
    for points, held in table:
        if points:
            yield at, held
        at += held
