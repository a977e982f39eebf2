"""The file of ``tin``: the surface in the format that the ending names."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import sparse

from ladar_volume.cli.inputs.reading import Source
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.export.formats import FORMATS
from ladar_volume.io.meshfiles.tin_files import check_tin_output
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.records import F64

#: Formats of a surface by the endings of their files; PLY holds more than these.
ENDINGS = {
    Path(FORMATS[name].file).suffix: name
    for name in ("landxml", "dxf", "obj", "stl", "glb", "tif", "contours")
}


def check_surface_output(arguments: argparse.Namespace) -> None:
    """Refuse an output that cannot be written, and options that its format has no room for; to ask
    before a long computation.
    """
    ending = check_tin_output(arguments.output, (".ply", *ENDINGS)).suffix.lower()
    if ending == ".ply":
        return
    for option, given in (
        ("--all-triangles", arguments.all_triangles),
        ("--frame scan", arguments.frame == "scan"),
    ):
        if given:
            raise ConfigurationError(
                f"{option} is for a surface as .ply, not {ending}", value=str(arguments.output)
            )
    from ladar_volume.io.export.export_set import check_packages

    check_packages([ENDINGS[ending]])


def write_as(
    path: Path,
    source: Source,
    surface: CloudSurface,
    sigma_z: F64 | None,
    covariance: sparse.csr_array | None,
) -> tuple[int, int]:
    """Write the relevant triangles in another format than PLY; whole or not. sigma_z (n,) m,
    covariance (n, n) m² : of the heights of the vertices. Returns numbers of vertices, faces.
    """
    # the other formats load what a PLY does not need
    from ladar_volume.io.export.deliverable import Deliverable, SurfacePoints
    from ladar_volume.io.export.export_set import ExportRequest, writer
    from ladar_volume.io.export.output_system import plain_words, system_of_cloud

    tin, name = surface.representation.tin, ENDINGS[path.suffix.lower()]
    surface_alone = Deliverable(
        name=plain_words(source.path.stem),
        tin=tin,
        counted=tin.relevant,
        base_m=None,
        other=None,
        sigma_m=sigma_z,
        covariance=covariance,
        points=SurfacePoints(np.zeros((0, 3)), {}),
        facts={},
        rows=(),
        system=system_of_cloud(source.cloud.coordinates, False),
        breaklines=() if source.mesh is None else source.mesh.breaklines,
    )
    with atomic_file(path) as part:
        writer(name, ExportRequest((name,)))(part, surface_alone)
    faces = tin.triangles[tin.relevant]
    return len(np.unique(faces)), len(faces)
