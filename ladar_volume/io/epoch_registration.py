"""Co-registration of two epochs with Open3D's iteration; imported only where used, the core does
not know it.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.records import F64
from ladar_volume.registration.icp import IcpResult, refine
from ladar_volume.registration.transform import Transform


def open3d_icp(source: F64, target: F64, normals: F64, reach_m: float, T_target_source: F64) -> F64:
    """Point-to-plane ICP of Open3D with Tukey's weights, from a start (4, 4): (4, 4), source to
    target.

    source : (n, 3) m · target, normals : (m, 3) m and unit. Coordinates are reduced to the target's
    mean, which map coordinates need.
    """
    import open3d as o3d

    middle = target.mean(axis=0)
    shift = np.eye(4)
    shift[:3, 3] = -middle
    back = np.eye(4)
    back[:3, 3] = middle
    a, b = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
    a.points = o3d.utility.Vector3dVector(
        source @ T_target_source[:3, :3].T + T_target_source[:3, 3] - middle
    )
    b.points, b.normals = (
        o3d.utility.Vector3dVector(target - middle),
        o3d.utility.Vector3dVector(normals),
    )
    icp = o3d.pipelines.registration
    estimation = icp.TransformationEstimationPointToPlane(icp.TukeyLoss(k=0.5 * reach_m))
    criteria = icp.ICPConvergenceCriteria(
        relative_fitness=1e-9, relative_rmse=1e-9, max_iteration=200
    )
    found = icp.registration_icp(a, b, reach_m, np.eye(4), estimation, criteria)
    out: F64 = back @ np.asarray(found.transformation) @ shift @ T_target_source
    return out


def register_epochs(
    source: F64,
    target: F64,
    normals: F64,
    start: Transform | None = None,
    *,
    reach_m: float,
    levelled: bool = False,
    cell_m: float = 0.0,
) -> IcpResult:
    """:func:`ladar_volume.registration.icp.refine` with Open3D's iteration going first; a levelled
    instrument needs no other program.
    """
    solver = None if levelled else open3d_icp
    return refine(
        source,
        target,
        normals,
        start,
        reach_m=reach_m,
        levelled=levelled,
        cell_m=cell_m,
        solver=solver,
    )
