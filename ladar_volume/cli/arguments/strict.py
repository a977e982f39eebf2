"""The option ``--strict`` and its exit code."""

from __future__ import annotations

import argparse

#: Exit code of ``--strict`` for a doubtful result.
DOUBTFUL = 3


def add_strict_option(parser: argparse.ArgumentParser) -> None:
    """Declare ``--strict``."""
    parser.add_argument(
        "--strict", action="store_true", help=f"exit with code {DOUBTFUL} for a doubtful result"
    )
