"""Examples at the end of each verb's ``--help``."""

from __future__ import annotations

import argparse

TITLE = "examples:"
#: Commands by verb, each with what it is for.
EXAMPLES = {
    "replay": (
        ("volume of a recording: out/report.html, result.json, mesh.ply", "bags/stockpile"),
        ("how the volume came about, in the report", "bags/box --convergence 5 -o out/box"),
        ("one parameter otherwise", "bags/stockpile --set volume.base=ground -o out/ground"),
    ),
    "filter": (
        ("settings from the cloud", "CLOUD.laz -o filtered.laz"),
        (
            "a radius of one's own, and what was taken out",
            "A.ply -o B.ply --radius 0.2 --outliers C.ply",
        ),
    ),
    "simulate": (("a survey with a known volume", "stockpile --platform uav --seed 7 -o flight"),),
    "tin": (("a surface of a tenth of the points", "CLOUD.ply -o tin.ply --vertices 0.1"),),
    "volume": (
        (
            "a pile above the ground about it, with a report",
            "PILE.laz --base ground --report pile.html",
        ),
        ("above a level, heights good to 2 cm", "PILE.xyz --units m --level 12.5 --sigma 0.02"),
        ("two surveys: cut and fill", "NEW.laz OLD.laz --json"),
        ("every pile of a yard, with tonnes", "YARD.laz --piles piles.geojson --density 1.6"),
        (
            "calibration and navigation in sigma, from the flight beside the cloud",
            "PILE.laz --base ground --trajectory FLIGHT.sbet --budget site.yaml",
        ),
        ("files for CAD and GIS", "PILE.laz --base ground -o out --as laz,tif,landxml,dxf"),
    ),
    "up": (
        ("live, with a page for the phone", "--config survey.yaml --page --log survey.mcap"),
        ("over a recording", "--play bags/box --rate 2"),
    ),
    "register": (("from reference spheres", "A.csv B.csv --json"),),
    "body": (("closed bodies on the ground", "CLOUD.ply -o bodies.ply"),),
    "diff": (("a pit between two scans", "A.ply B.ply --pole 0,0,2"),),
    "epochs": (("change between two replayed surveys", "out/may out/june"),),
    "export": (("for CAD and GIS, in UTM", "out -o files --as all --crs EPSG:32632"),),
    "tiles": (
        ("a mine above a level, on the cores of this machine", "MINE.copc.laz --level 310 --dask"),
        ("what rises above its own ground", "YARD.laz --base ground --sigma 0.02"),
    ),
    "sites": (("every pile of every week", "yards -o table --piles found --density 1.6"),),
    "plan": (("every scanner with every IMU", "--volume 100 --compare"),),
}


class Formatter(argparse.HelpFormatter):
    """Wraps text, and leaves the lines of examples as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith(TITLE):
            return text
        return super()._fill_text(text, width, indent)


def add_examples(verb: str, parser: argparse.ArgumentParser) -> None:
    """Put the examples of a verb at the end of its help."""
    if verb not in EXAMPLES:
        return
    lines = [f"  ladar_volume {verb} {words}\n      {what}" for what, words in EXAMPLES[verb]]
    parser.epilog = "\n".join([TITLE, *lines])
    parser.formatter_class = Formatter
