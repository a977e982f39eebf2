"""The option for published settings of the ground."""

from __future__ import annotations

import argparse

from ladar_volume.ground.ground_presets import PRESETS


def add_ground_preset(group: argparse._ActionsContainer) -> None:
    """Declare ``--ground-preset``."""
    group.add_argument(
        "--ground-preset",
        choices=sorted(PRESETS),
        help="published settings of the ground (T, k, outliersThreshold)",
    )
