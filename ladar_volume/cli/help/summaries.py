"""What the verbs do, in a line each: ``ladar_volume --help`` loads nothing else of them."""

from __future__ import annotations

SUMMARIES = {
    "replay": "volume of a recorded survey, offline",
    "filter": "filter a point cloud file: outliers out, noise down, edges kept",
    "simulate": "simulate a survey of a scene with a known volume",
    "tin": "triangulate a point cloud file, with all of its points or the few that represent them",
    "volume": "cut and fill of a point cloud file above a base, or between two",
    "study": "repeat a published experiment on simulated data",
    "up": "run the nodes; with --play over a recording",
    "register": "transform between two frames from reference spheres",
    "body": "volumes of closed bodies, from a point cloud or a mesh file",
    "calibrate": "calibration constants and their sigmas, as a parameter file",
    "diff": "volume between two scans by tetrahedra to a pole, for pits with steep and overhanging "
    "walls",
    "plan": "predict the volume's sigma before the flight",
    "epochs": "change between two surveys, with level of detection",
    "export": "files of a replayed survey for other programs",
    "tiles": "cut and fill of a cloud larger than the memory, by tiles, on as many workers",
    "sites": "the volumes of many surveys in one table, and their change from time to time",
}
