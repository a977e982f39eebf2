"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from ladar_volume.model.errors import OutputError


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside ``path``, with its ending, to write to; renamed to it when the block ends well,
    else removed.

    Raises :class:`OutputError` where it cannot be written.
    """
    part = path.with_name(
        f".{path.stem}.part{path.suffix.lower()}"
    )  # the ending tells libraries the kind
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}", value=str(path)) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
