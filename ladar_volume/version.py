"""The version: read from the installed package, or from package.xml in a source tree."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree


def version() -> str:
    """Version of this package; package.xml of the source tree wins over an older installed copy."""
    manifest = Path(__file__).parent.parent / "package.xml"
    if manifest.is_file():
        return str(ElementTree.parse(manifest).findtext("version"))
    from importlib import metadata  # a quarter of the time that --help takes

    return metadata.version("ladar_volume")
