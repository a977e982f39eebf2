"""Complete binary trees of boxes: node i has children 2 i and 2 i + 1, node 1 is the root."""

from __future__ import annotations

from ladar_volume.math.array_types import F64
from ladar_volume.math.kernels import kernel


@kernel
def join_boxes(boxes: F64) -> None:
    """Write the boxes of the inner nodes of a tree (2 k, 2 d) whose leaves are k to 2 k − 1; each
    box is d low coordinates, then d high ones.
    """
    d = boxes.shape[1] // 2
    for node in range(len(boxes) // 2 - 1, 0, -1):
        for c in range(d):
            boxes[node, c] = min(boxes[2 * node, c], boxes[2 * node + 1, c])
            boxes[node, d + c] = max(boxes[2 * node, d + c], boxes[2 * node + 1, d + c])
