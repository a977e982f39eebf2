"""Recordings, logs of autopilots, outlines, meshes of offices and folders of results to mutate for
:mod:`benchmarks.fuzz_files`, and the command lines that read them.

Every command line has a folder of good files of which one is mutated.
"""

from __future__ import annotations

import json
import random
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
SQUARE = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
#: Endings of files that are text.
TEXTS = (".yaml", ".json", ".geojson", ".kml", ".dxf", ".wkt", ".xml", ".csv", ".prj")
Words = tuple[str, ...]
#: The command line over a folder: where it is, where its output goes, a number or word.
Line = Callable[[Path, Path, str], Words]


@dataclass(frozen=True)
class Kind:
    """folder : good files · target : the one that is mutated · lines : command lines · output :
    file below the output folder that an earlier run left, if the verb writes one
    """

    folder: Path
    target: str
    lines: tuple[Line, ...]
    output: str = ""


def program(*words: str) -> None:
    """A verb in a process of its own: threads of this one would not outlive a fork. Its error, if
    any, is printed: what it should have made is then missing.
    """
    run = [sys.executable, "-m", "ladar_volume.cli.main", "--quiet", *words]
    subprocess.run(run, check=False, cwd=ROOT, stdout=subprocess.DEVNULL)


def kinds(folder: Path) -> dict[str, Kind]:
    """All of them, by what is mutated."""
    return (
        recordings(folder / "recordings")
        | outlines(folder / "outlines")
        | surveys(folder / "surveys")
        | stores(folder / "stores")
    )


def recordings(folder: Path) -> dict[str, Kind]:
    """A short flight as MCAP, SQLite and ROS 1 bag, packets of a scanner, logs of an autopilot."""
    folder.mkdir(parents=True)
    short = ("--duration", "3", "--thin", "60", "--imu-hz", "50")
    program("simulate", "stockpile", *short, "-o", str(folder / "sim"))
    other_storages(folder)
    packets, poses = folder / "packets", folder / "poses"
    packets.mkdir()
    capture = (ROOT / "test" / "data" / "vlp16_gps.pcap").read_bytes()
    (packets / "a.pcap").write_bytes(capture[: 24 + 60 * 1264])
    shutil.copytree(packets, poses)
    (poses / "a.tlog").write_bytes(telemetry())
    (poses / "a.bin").write_bytes(dataflash())
    (poses / "b.bin").write_bytes(dataflash())
    bags = {
        "recording mcap": Kind(folder / "sim", "sim.mcap", RECORDING, "result.json"),
        "recording metadata": Kind(folder / "sim", "metadata.yaml", RECORDING, "result.json"),
        "recording config": Kind(folder / "sim", "config.yaml", RECORDING[:2], "result.json"),
        "recording sqlite": Kind(folder / "lite", "lite.db3", RECORDING, "result.json"),
        "recording ros1": Kind(folder / "one", "one.bag", RECORDING, "result.json"),
        "recording packets": Kind(packets, "a.pcap", tuple(map(of_capture, RECORDING[2:]))),
    }
    for name in ("a.tlog", "a.bin"):
        bags[f"recording {name}"] = Kind(poses, name, (with_poses(name),), "result.json")
    return {name: kind for name, kind in bags.items() if (kind.folder / kind.target).exists()}


LEVEL = ("--set", "volume.base=level", "--set", "volume.level_m=0")
RECORDING: tuple[Line, ...] = (
    lambda at, out, n: ("replay", str(at), "--no-figure", *LEVEL, "-o", str(out)),
    lambda at, out, n: ("replay", str(at), "--no-figure", f"--start={n}", "-o", str(out)),
    lambda at, out, n: ("info", str(at)),
    lambda at, out, n: ("info", str(at), "--json"),
    lambda at, out, n: ("calibrate", "strips", str(at), f"--edge={n}", "--returns", "2000"),
    lambda at, out, n: (
        *("replay", str(at), "--no-figure", f"--duration={n}", "--topic", f"cloud={n[:60]}"),
        *("-o", str(out)),
    ),
)


def of_capture(line: Line) -> Line:
    """The line over the file of packets in the folder."""
    return lambda at, out, n: line(at / "a.pcap", out, n)


def with_poses(name: str) -> Line:
    """Packets with the poses of an autopilot's log."""

    def line(at: Path, out: Path, n: str) -> Words:
        log = ("--poses", str(at / name), "--set", f"mavlink.gnss_delay_s={n[:40]}")
        return ("replay", str(at / "a.pcap"), *log[: 2 if n == "1.5" else 4], "-o", str(out))

    return line


def other_storages(folder: Path) -> None:
    """The flight as an SQLite and as a ROS 1 recording."""
    from rosbags.convert import convert
    from rosbags.typesys import Stores, get_typestore

    types = (get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC))
    kept = ((), (), (), ())
    (folder / "one").mkdir()
    for to, types_of in ((folder / "lite", types[:1] * 2), (folder / "one" / "one.bag", types)):
        convert([folder / "sim"], to, "sqlite3", 9, None, "none", *types_of, *kept)
        shutil.copy(folder / "sim" / "config.yaml", folder / to.stem)


def telemetry() -> bytes:
    """Attitudes and positions as a telemetry log holds them."""
    from pymavlink.dialects.v20 import ardupilotmega as mav

    link, out = mav.MAVLink(None, 1, 1), b""
    for i in range(120):
        boot_ms, us = 2000 + 20 * i, 1_700_000_000_000_000 + 20_000 * i
        each = [link.attitude_encode(boot_ms, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)]
        if i % 5 == 0:
            each.append(link.system_time_encode(us, boot_ms))
            each.append(
                link.gps_raw_int_encode(
                    *(us, 6, 501234567, 141234567, 250_000, 80, 80, 0, 0, 17, 294_000, 20, 30)
                )
            )
        out += b"".join(struct.pack(">Q", us) + m.pack(link) for m in each)
    return out


def dataflash() -> bytes:
    """A small log of ArduPilot's flash."""
    sys.path.insert(0, str(ROOT / "test" / "io"))
    from test_mavlink import dataflash as made

    return bytes(made())


def outlines(folder: Path) -> dict[str, Kind]:
    """A cloud with two outlines in every format, a budget of heights, and a mesh of LandXML."""
    import pyogrio
    import shapely

    from ladar_volume.io.pointfiles.cloud_files import write_cloud

    folder.mkdir(parents=True)
    rng = np.random.default_rng(8)
    xy = rng.uniform(-4.0, 4.0, (900, 2))
    z = np.maximum(0.0, 1.0 - np.hypot(*xy.T)) + rng.normal(0.0, 0.003, 900)
    write_cloud(folder / "c.ply", np.column_stack([xy, z]), {}, encoding="binary")
    shape = np.array([shapely.to_wkb(shapely.Polygon(SQUARE))], object)
    drivers = {"shp": "ESRI Shapefile", "gpkg": "GPKG", "fgb": "FlatGeobuf", "kml": "KML"}
    for ending, driver in drivers.items():
        pyogrio.raw.write(
            *(folder / f"o.{ending}", shape, [np.array(["one"], object)], ["name"]),
            geometry_type="Polygon",
            crs="EPSG:4326" if ending == "kml" else "EPSG:25832",
            driver=driver,
        )
    ring = {"type": "Polygon", "coordinates": [[*SQUARE, SQUARE[0]]]}
    facts = {"type": "Feature", "properties": {"name": "one", "density": 1.7}, "geometry": ring}
    named = {"type": "name", "properties": {"name": "EPSG:25832"}}
    every = {"type": "FeatureCollection", "crs": named, "features": [facts]}
    (folder / "o.geojson").write_text(json.dumps(every))
    (folder / "o.wkt").write_text(shapely.Polygon(SQUARE).wkt)
    corners = "".join(f"0\nVERTEX\n8\na\n10\n{x}\n20\n{y}\n" for x, y in SQUARE)
    line = f"0\nPOLYLINE\n8\na\n66\n1\n70\n1\n{corners}0\nSEQEND\n"
    (folder / "o.dxf").write_text(f"0\nSECTION\n2\nENTITIES\n{line}0\nENDSEC\n0\nEOF\n")
    (folder / "budget.yaml").write_text(
        "height_errors:\n  - {name: datum, sigma_m: 0.01}\n"
        "  - {name: trajectory, sigma_m: 0.02, correlation_m: 30}\n"
    )
    shutil.copy(ROOT / "test" / "data" / "road_crop.xml", folder / "road.xml")
    names = ("shp", "dbf", "shx", "prj", "gpkg", "fgb", "kml", "geojson", "wkt", "dxf")
    out = {f"outline {n}": Kind(folder, f"o.{n}", (piles_of(n),), "result.json") for n in names}
    out["budget"] = Kind(folder, "budget.yaml", (BUDGET,))
    out["mesh a.xml"] = Kind(folder, "road.xml", LANDXML)
    return out


def piles_of(ending: str) -> Line:
    """Piles within outlines of a file."""
    name = "shp" if ending in ("dbf", "shx", "prj") else ending

    def line(at: Path, out: Path, n: str) -> Words:
        by = ("--base", "toe_plane", "--crs", "EPSG:25832", f"--density={n}")
        start = ("volume", str(at / "c.ply"), "--piles", str(at / f"o.{name}"))
        return (*start, *by[: 4 if n == "1.5" else 5], "-o", str(out), "--as", "json,csv,geojson")

    return line


def BUDGET(at: Path, out: Path, n: str) -> Words:
    """A volume with errors that heights share."""
    length = () if n == "1.5" else (f"--height-sigma={n}", f"--correlation={n}")
    budget = ("--budget", str(at / "budget.yaml"), *length)
    return ("volume", str(at / "c.ply"), "--level", "0", *budget, "--json")


LANDXML: tuple[Line, ...] = (
    lambda at, out, n: ("volume", str(at / "road.xml"), f"--level={n}", "--json"),
    lambda at, out, n: ("volume", str(at / "road.xml"), "--level", "14", f"--surface={n[:50]}"),
    lambda at, out, n: ("volume", str(at / "road.xml"), str(at / "c.ply"), "--json"),
    lambda at, out, n: ("body", str(at / "road.xml"), "-o", str(at / "made.obj")),
)


def surveys(folder: Path) -> dict[str, Kind]:
    """Folders of two replayed surveys, and a folder of dated clouds with its table."""
    from benchmarks.fuzz_files import survey

    for name in ("may", "june"):
        (folder / "epochs" / name).mkdir(parents=True)
        survey(folder / "epochs" / name)
    (folder / "epochs" / "T.json").write_text(transform())
    sites = folder / "sites"
    (sites / "in").mkdir(parents=True)
    cloud = folder.parent / "outlines" / "c.ply"
    for name in ("pile_2026-04-01", "pile_2026-05-01"):
        shutil.copy(cloud, sites / "in" / f"{name}.ply")
    program("sites", str(sites / "in"), "--level", "0", "-o", str(sites / "out"))
    kept = sorted((sites / "out" / "results").glob("*.json"))[0]
    epochs: tuple[Line, ...] = (
        lambda at, out, n: ("epochs", str(at / "may"), str(at / "june"), "-o", str(out)),
        lambda at, out, n: (
            *("epochs", str(at / "may"), str(at / "june"), "--no-figure", f"--stable={n[:99]}"),
            *("--transform", str(at / "T.json"), "-o", str(out)),
        ),
    )
    again: tuple[Line, ...] = (
        lambda at, out, n: ("sites", str(at / "in"), "--level", "0", "-o", str(at / "out")),
    )
    return {
        "epoch": Kind(folder / "epochs", "june/result.mcap", epochs, "epochs.json"),
        "epoch transform": Kind(folder / "epochs", "T.json", epochs[1:], "epochs.json"),
        "site cloud": Kind(sites, "in/pile_2026-05-01.ply", again),
        "site result": Kind(sites, str(kept.relative_to(sites)), again),
        "site name": Kind(sites, "in/pile_2026-05-01.ply", (SITE_NAME,)),
    }


def SITE_NAME(at: Path, out: Path, n: str) -> Words:
    """Surveys whose names hold what names may."""
    name = "".join(c for c in n if c not in "/\x00")[:60] or "x"
    shutil.copy(at / "in" / "pile_2026-04-01.ply", at / "in" / f"{name}_20261301.ply")
    return ("sites", str(at / "in"), f"--level={n}", "-o", str(at / "out"), "--json")


def transform() -> str:
    """A motion with its covariance."""
    facts: dict[str, object] = {"matrix": np.eye(4).tolist(), "pivot_m": [0, 0, 0], "scale": 1.0}
    return json.dumps(facts | {"covariance": (1e-6 * np.eye(7)).tolist()}, indent=1)


def stores(folder: Path) -> dict[str, Kind]:
    """Tiles at rest, a plan's and a simulation's parameters."""
    from ladar_volume.io.pointfiles.cloud_files import write_cloud

    folder.mkdir(parents=True)
    rng = np.random.default_rng(9)
    r = np.column_stack([rng.uniform(0.0, 6.0, (3_000, 2)), rng.normal(2.0, 0.01, 3_000)])
    write_cloud(folder / "c.las", r, {}, encoding=None)
    (folder / "p.yaml").write_text("budget: {range_m: 0.02}\nfilter: {radius_m: 0.3}\n")
    tiles = ("--tile", "2", "--store", str(folder / "tiles"))
    program("tiles", str(folder / "c.las"), "--level", "0", *tiles)
    again: tuple[Line, ...] = (
        lambda at, out, n: (
            *("tiles", str(at / "c.las"), "--level", "0", "--tile", "2"),
            *("--store", str(at / "tiles")),
        ),
    )
    planned: tuple[Line, ...] = (
        lambda at, out, n: ("plan", f"--volume={n}", "--config", str(at / "p.yaml"), "--json"),
        lambda at, out, n: ("plan", "--pile", "20", n[:50], "4", "--config", str(at / "p.yaml")),
        lambda at, out, n: (
            *("simulate", "cone", "--duration", "1", "--thin", "100", f"--outage=0:{n[:60]}"),
            *("--config", str(at / "p.yaml"), "-o", str(at / "flight")),
        ),
    )
    files = sorted(p.relative_to(folder) for p in (folder / "tiles").rglob("*") if p.is_file())
    out = {f"tiles {p.name}": Kind(folder, str(p), again) for p in (files[0], files[-1])}
    return out | {"plan": Kind(folder, "p.yaml", planned)}


def made(
    kind: Kind,
    at: Path,
    number: str | None,
    mutate: Callable[..., bytes],
    random_: random.Random,
) -> tuple[Words, Path, Path | None]:
    """A command line over a fresh copy of the folder, with a file mutated, or an option where a
    number is given; the file; the file of an earlier run, if any.
    """
    for old in (at / "in", at / "to"):
        shutil.rmtree(old, ignore_errors=True)
    shutil.copytree(kind.folder, at / "in")
    bad = at / "in" / kind.target
    if number is None:
        bad.write_bytes(mutate(bad.read_bytes(), text=bad.suffix in TEXTS))
    words = random_.choice(kind.lines)(at / "in", at / "to", number or "1.5")
    return words, bad, at / "to" / kind.output if kind.output else None
