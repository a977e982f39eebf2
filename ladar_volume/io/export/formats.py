"""The formats of results by the words of ``--as``; their writers load what each needs."""

from __future__ import annotations

from dataclasses import dataclass

from ladar_volume.model.errors import ConfigurationError


@dataclass(frozen=True)
class Format:
    """file : name in the folder · what : in words · needs : package beyond those of every verb"""

    file: str
    what: str
    needs: str = ""


FORMATS = {
    "json": Format("result.json", "the result, as docs/result.schema.json describes it"),
    "csv": Format("volumes.csv", "one volume a row"),
    "las": Format("points.las", "points with sigma, LAS 1.4"),
    "laz": Format("points.laz", "the same, compressed"),
    "copc": Format("points.copc.laz", "the same, cloud-optimised (COPC) for viewers"),
    "ply": Format("surface.ply", "the surface with sigma of its vertices"),
    "tif": Format("surface.tif", "heights, sigma and base as GeoTIFF", "rasterio"),
    "landxml": Format("surface.xml", "surface and base as LandXML 1.2 TINs"),
    "dxf": Format("surface.dxf", "surface, base and outline as DXF", "ezdxf"),
    "obj": Format("surface.obj", "surface and base"),
    "stl": Format("surface.stl", "the surface where the volume counts"),
    "glb": Format("surface.glb", "surface and base for viewers"),
    "geojson": Format("outline.geojson", "outlines of what counts"),
    "contours": Format("contours.geojson", "contours of the surface"),
}
#: Those that are written where nobody chooses: they need no further package.
USUAL = ("json", "csv", "laz", "ply", "landxml", "geojson", "contours")


def formats_of(text: str | None) -> tuple[str, ...]:
    """Formats of ``--as``: words with commas, or "all"; the usual ones for None. The result itself
    is always among them. Raises :class:`ConfigurationError`.
    """
    if text is None:
        return USUAL
    words = [word.strip().lower() for word in text.split(",") if word.strip()]
    words = list(FORMATS) if words == ["all"] else words
    unknown = [word for word in words if word not in FORMATS]
    if unknown or not words:
        raise ConfigurationError(
            f"--as {text}: {', '.join(unknown) or 'nothing'} is none of {', '.join(FORMATS)}, all",
            value=text,
        )
    return tuple(dict.fromkeys(["json", *words]))
