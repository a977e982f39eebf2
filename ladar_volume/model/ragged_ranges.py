"""A range of patches, their ragged parts with them."""

from __future__ import annotations

import dataclasses
from typing import Any

from ladar_volume.model.records import PatchTable

#: What is ragged, by its CSR starts.
RAGGED = {"cross_start": ("cross_key", "cross"), "nav_start": ("nav_bin", "M_nav", "nav_residual")}


def patch_range(patches: PatchTable, first: int, last: int) -> dict[str, Any]:
    """What :class:`PatchTable` has of those from ``first`` to ``last``, by name; their CSR parts
    begin at 0.
    """
    rows = {
        field.name: getattr(patches, field.name)[first:last]
        for field in dataclasses.fields(PatchTable)
    }
    for start, names in RAGGED.items():
        begin, end = getattr(patches, start)[[first, last]]
        rows[start] = getattr(patches, start)[first : last + 1] - begin
        rows |= {name: getattr(patches, name)[begin:end] for name in names}
    return rows
