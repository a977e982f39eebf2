"""Mutated files and options over the verbs, each in a process of its own with 4 GB of address
space: how many end with a traceback or a defect, hang, or are refused in more than one line of 300
characters; and whether a refusal harms the output of an earlier run.

Good small files of every kind are mutated at random: bytes flipped, cut, repeated, filled with
zeros; numbers in text replaced by NaN, infinite, huge, denormal ones and by words; words and lines
doubled, dropped or exchanged. Options get such numbers and words as well.

``python -m benchmarks.fuzz_files [--count N] [--seed S] [--corpus FOLDER]``; exit code 1 where
anything of this was seen. Cases found are kept below the corpus folder when it is given.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz_folders import Kind, kinds, made, program
from ladar_volume.cli.main import DEFECT
from ladar_volume.cli.main import main as verb

MEMORY, SECONDS, LINE = 4 * 2**30, 60.0, 300
#: A case hangs after SECONDS of the processor, or after so much time: other work on the machine
#: makes everything slow, and a deadlock takes no processor.
WAIT_S = 300.0
#: Modules that do the work of the verbs.
WORK = (
    *("filter", "tin", "volume", "body", "diff", "register", "calibrate", "calibrate_strips"),
    *("replay", "epochs.surveys", "epochs.clouds", "plan", "outputs.export", "scale.tiles"),
    "scale.sites",
)
#: Libraries that a verb loads when it needs them; loaded once, too, where they are installed.
LIBRARIES = (
    *("rasterio", "ezdxf", "pye57", "laspy", "pyproj", "matplotlib.pyplot"),
    *("pyogrio", "shapely", "rosbags.highlevel"),
)
#: Kinds of files that ``export`` and ``volume -o`` write, and words that are none.
KINDS = (
    *("json", "csv", "las", "laz", "ply", "tif", "landxml", "dxf", "obj", "stl", "glb"),
    *("geojson", "contours", "all", "csv,csv", "json,nothing", ","),
)
#: Exit codes that a verb may have: done, refused, doubtful with --strict.
GOOD = (0, 2, 3)
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
WORDS = (
    *(b"nan", b"inf", b"-inf", b"1e155", b"-1e308", b"1e-310", b"0", b"-1", b"1e999", b""),
    *(b"9" * 20, b"9" * 5000, b"4294967296", b"-2147483649", b"[bold]", b"\x1b[31m", b"0x10"),
    *(b"\xff\xfe", b"%s", b"{}", b"[" * 3000, b"\x00", b"1,5", b"1e", b"--", b"x" * 2000),
)


@dataclass(frozen=True)
class Case:
    """words : the command line · files : those it reads · output : what it writes, if anything"""

    words: tuple[str, ...]
    files: tuple[Path, ...]
    output: Path | None = None


def mutated(data: bytes, random_: random.Random, text: bool) -> bytes:
    """One to four random changes."""
    for _ in range(random_.randrange(1, 5)):
        data = (_word if text and random_.random() < 0.7 else _bytes)(data, random_)
    return data


def _word(data: bytes, random_: random.Random) -> bytes:
    """Another number, word or line; those of the header, which says what is there, more often."""
    near = data[: 1_500 if random_.random() < 0.6 else len(data)]
    found = list(NUMBER.finditer(near))
    kind = random_.randrange(4)
    if kind < 2 and found:
        at = random_.choice(found)
        return data[: at.start()] + random_.choice(WORDS) + data[at.end() :]
    lines = data.split(b"\n")
    k = random_.randrange(min(len(lines), 40))
    if kind == 2:
        return b"\n".join([*lines[:k], *lines[k + random_.randrange(3) :]])
    other = random_.randrange(len(lines))
    lines[k], lines[other] = lines[other], lines[k] if random_.random() < 0.5 else lines[other]
    return b"\n".join(lines)


def _bytes(data: bytes, random_: random.Random) -> bytes:
    if not data:
        return random_.randbytes(40)
    out, size = bytearray(data), len(data)
    kind = random_.randrange(6)
    at = random_.randrange(min(size, 400) if random_.random() < 0.6 else size)
    if kind == 0:
        return data[:at]
    if kind == 1:
        for _ in range(random_.randrange(1, 20)):
            out[random_.randrange(min(size, 400))] = random_.randrange(256)
    elif kind == 2:
        out[at : at + 8] = random_.choice((b"\xff" * 8, b"\x00" * 8, b"\x7f" + b"\xff" * 7))
    elif kind == 3:
        out[at:at] = out[at : at + random_.randrange(1, 200)]
    elif kind == 4:
        del out[at : at + random_.randrange(1, 200)]
    else:
        out[at : at + 40] = bytes(min(40, size))
    return bytes(out)


def seeds(folder: Path) -> dict[str, Path]:
    """A good small file of every kind, by what it is."""
    from ladar_volume.io.config import dump_config
    from ladar_volume.io.meshfiles.mesh_files import write_mesh
    from ladar_volume.io.pointfiles.cloud_files import write_cloud
    from ladar_volume.model.parameters import Parameters

    rng = np.random.default_rng(3)
    xy = rng.uniform(-2.0, 2.0, (600, 2))
    z = np.maximum(0.0, 1.0 - np.hypot(*xy.T)) + rng.normal(0.0, 0.003, 600)
    r = np.column_stack([xy, z])
    out: dict[str, Path] = {}
    columns = {"intensity": np.ones(len(r), np.float32), "sphere": np.arange(len(r)) % 4}
    for name, encoding in (
        *(("a.ply", "ascii"), ("b.ply", "binary"), ("a.pcd", "ascii"), ("b.pcd", "binary")),
        *(("c.pcd", "binary_compressed"), ("a.npy", None), ("a.csv", None), ("a.xyz", None)),
        *(("a.las", None), ("a.laz", None)),
    ):
        write_cloud(folder / name, r, columns, encoding=encoding)
        out[f"cloud {name}"] = folder / name
    v = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
    faces = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]]
    faces += [[2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]
    for name in ("m.ply", "m.obj", "m.stl", "m.off"):
        write_mesh(folder / name, v, np.array(faces, np.int32))
        out[f"mesh {name}"] = folder / name
    (folder / "p.yaml").write_text(dump_config(Parameters()))
    facts = {"matrix": np.eye(4).tolist(), "pivot_m": [0, 0, 0], "scale": 1.0}
    facts["covariance"] = (1e-6 * np.eye(7)).tolist()
    (folder / "T.json").write_text(json.dumps(facts, indent=1))
    (folder / "a.e57").write_bytes(e57(r))
    out["cloud a.e57"] = folder / "a.e57"
    np.savetxt(folder / "a.pts", r, fmt="%.4f", header=str(len(r)), comments="")
    out["cloud a.pts"] = folder / "a.pts"
    (folder / "a.tif").write_bytes(geotiff(r))
    out["cloud a.tif"] = folder / "a.tif"
    survey(folder)
    rows = "".join(f"{x:.4f},{y:.4f}\n" for x, y in rng.normal(0.0, 0.01, (12, 2)))
    (folder / "c.csv").write_text(f"roll_deg,pitch_deg\n{rows}")
    (folder / "corners.txt").write_text("-1 -1\n1 -1\n1 1\n-1 1\n")
    return out | {
        "yaml": folder / "p.yaml",
        "transform": folder / "T.json",
        "repeats": folder / "c.csv",
        "corners": folder / "corners.txt",
        "survey": folder / "result.mcap",
    }


def geotiff(r: np.ndarray) -> bytes:
    """A raster of the highest of the points (n, 3) in each cell."""
    import rasterio
    from rasterio.io import MemoryFile

    z = np.full((24, 24), -9999.0)
    row, column = np.clip((12.0 - 6.0 * r[:, 1], 12.0 + 6.0 * r[:, 0]), 0, 23).astype(int)
    np.maximum.at(z, (row, column), r[:, 2])
    place = rasterio.Affine(1.0 / 6.0, 0.0, -2.0, 0.0, -1.0 / 6.0, 2.0)
    shape = {"width": 24, "height": 24, "count": 1, "dtype": "float64", "nodata": -9999.0}
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", crs="EPSG:25832", transform=place, **shape) as file:
            file.write(z, 1)
        return bytes(memory.read())


def e57(r: np.ndarray) -> bytes:
    """The points as an E57 file; empty where pye57 is not installed."""
    with tempfile.TemporaryDirectory() as name, contextlib.suppress(ImportError):
        import pye57

        file = pye57.E57(str(Path(name) / "a.e57"), mode="w")
        file.write_scan_raw({f"cartesian{axis}": r[:, k] for k, axis in enumerate("XYZ")})
        file.close()
        return (Path(name) / "a.e57").read_bytes()
    return b""


def survey(folder: Path) -> None:
    """A small survey as ``replay`` writes it: a slope above a level."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "scenes"))
    from volume_surfaces import platform, surface_update

    from ladar_volume.io.results import result_dict
    from ladar_volume.io.surveys import write_survey
    from ladar_volume.model.losses import Losses
    from ladar_volume.model.parameters import Parameters
    from ladar_volume.model.records import Datum
    from ladar_volume.volume.estimator import VolumeEstimator

    base = {"base": "level", "level_m": 0.0, "outline": "all"}
    p = Parameters.read({"filter": {"nav_bin_s": 1.0}, "volume": base})
    estimator = VolumeEstimator(p)
    estimator.add_platform(platform(position=0.002, attitude=0.0))
    estimator.add(surface_update(lambda x, y: 3.0 + 0.02 * x, half=4.0, perturb=0.004))
    estimate, source = estimator.estimate(), {"path": "flight", "sha256": "0"}
    facts = result_dict(estimate, p, Losses(), Datum(50.0, 14.0, 100.0), {}, source)
    facts |= {"where_more_data_helps": {"places": [], "sigma_m3": 0.0, "sigma_gaps_m3": 0.0}}
    write_survey(folder / "result.mcap", estimate, estimator.epoch(), facts)


def of_survey(bad: Path, folder: Path, number: str, random_: random.Random) -> Case:
    """A command line over a mutated survey, or a good one with a mutated option."""
    out = folder / "files"
    option = random_.choice(("--cell", "--contour-interval", "--crs", "--as"))
    value = random_.choice(KINDS) if option == "--as" else number
    if random_.random() < 0.2:
        return Case(("info", str(bad), "--json"), (bad,))
    words = ("export", str(bad), "-o", str(out), f"{option}={value}")
    return Case(words, (bad,), out / "result.json")


def of_files(bad: Path, folder: Path, number: str, random_: random.Random) -> Case:
    """A command line whose cloud becomes a folder of files, a report, or tiles at rest."""
    out, page = folder / "files", folder / "page.html"
    start = ("volume", str(bad), "--level", "0")
    into = ("-o", str(out), "--as", random_.choice(KINDS))
    corners = f"[-1, -1, 1, -1, 1, 1, -1, {number[:99]}]"
    outline = ("--set", "volume.outline=polygon", "--set", f"volume.polygon_m={corners}")
    store = ("--store", str(folder / "tiles"), "--tile", "2")
    known = [
        Case((*start, *into), (bad,), out / "result.json"),
        Case((*start, *into, f"--cell={number}"), (bad,), out / "result.json"),
        Case((*start, *into, "--file-units"), (bad,), out / "result.json"),
        Case((*start, *into, f"--contour-interval={number}"), (bad,), out / "result.json"),
        Case((*start, "--report", str(page)), (bad,), page),
        Case((*start, *outline, "--json"), (bad,)),
        Case(("volume", str(bad), "--outline", number[:99] or "auto"), (bad,)),
    ]
    if bad.suffix in (".las", ".laz"):
        known += [Case(("tiles", str(bad), "--level", "0", *store), (bad,))] * 4
        known += [Case(("tiles", str(bad), f"--level={number}", *store), (bad,))] * 2
    return random_.choice(known)


def case(kind: str, known: dict[str, Path], folder: Path, random_: random.Random) -> Case:
    """A command line over one mutated file, or over good ones with a mutated option."""
    source = known[kind]
    bad = folder / f"x{source.suffix}"
    text = source.suffix in (".csv", ".xyz", ".yaml", ".json", ".txt", ".obj", ".off")
    text |= source.name in ("a.ply", "a.pcd", "m.off") or random_.random() < 0.3
    by_option = random_.random() < 0.3
    data = source.read_bytes()
    bad.write_bytes(data if by_option else mutated(data, random_, text))
    number = random_.choice(WORDS).decode("latin-1").replace("\x00", "") if by_option else "1.5"
    good = str(known["cloud b.ply"])
    out = folder / f"out{random_.choice(('.ply', '.csv', '.pcd', '.las'))}"
    mesh = folder / f"out{random_.choice(('.ply', '.obj', '.stl', '.off'))}"
    ply = folder / "out.ply"
    if kind == "yaml":
        words = ("check-config", str(bad), "--set", f"filter.radius_m={number}")
        return Case(words, (bad,))
    if kind == "transform":
        words = ("diff", good, good, "--transform", str(bad), "--pole", f"0,0,{number}")
        return Case((*words, "-o", str(mesh)), (bad,), mesh)
    if kind == "survey":
        return of_survey(bad, folder, number, random_)
    if kind == "repeats":
        return Case(("calibrate", "repeats", str(bad), "--json"), (bad,))
    if kind == "corners":
        words = ("diff", good, good, "--polygon", str(bad), "--pole", f"0,0,{number}")
        return Case((*words, "-o", str(mesh)), (bad,), mesh)
    if kind.startswith("cloud") and random_.random() < 0.4:
        return of_files(bad, folder, number, random_)
    cloud = [
        Case(("filter", str(bad), f"--radius={number}", "-o", str(out)), (bad,), out),
        Case(("filter", str(bad), "-o", str(out)), (bad,), out),
        Case(("tin", str(bad), f"--max-edge={number}", "-o", str(ply)), (bad,), ply),
        Case(("volume", str(bad), f"--level={number}", "--json"), (bad,)),
        Case(("volume", str(bad), "--base", "ground"), (bad,)),
        Case(("volume", good, str(bad)), (bad,)),
        Case(("body", str(bad), "-o", str(mesh)), (bad,), mesh),
        Case(("register", str(bad), good, "--json"), (bad,)),
        Case(("volume", str(bad), "--level", "0", "--units", number[:50]), (bad,)),
        Case(("tin", str(bad), "--crs", number[:50], "-o", str(ply)), (bad,), ply),
        of_epochs(bad, good, folder / "change", number, random_),
    ]
    return random_.choice(cloud)


def of_epochs(bad: Path, good: str, out: Path, number: str, random_: random.Random) -> Case:
    """Two clouds compared, one of them mutated, or with a mutated option."""
    two = [good, str(bad)] if random_.random() < 0.5 else [str(bad), good]
    more = {
        "none": (),
        "icp": ("--register", "icp"),
        "height": ("--register", "height"),
        "reach": ("--register", "icp", f"--reach={number}"),
        "sigma": (f"--sigma={number}",),
        "stable": ("--stable", "0,0", "1,0", f"1,{number[:99]}"),
    }
    given = more[random_.choice(sorted(more))]
    words = ("epochs", *two, *given, "--no-figure", "-o", str(out))
    return Case(words, (bad,), out / "epochs.json")


def of_folder(kind: Kind, folder: Path, random_: random.Random) -> Case:
    """A command line over a folder of good files with a bad one, or with a mutated option."""
    number = None
    if random_.random() < 0.25:
        number = random_.choice(WORDS).decode("latin-1").replace("\x00", "")
    words, bad, output = made(kind, folder, number, partial(mutated, random_=random_), random_)
    return Case(words, (bad,), output)


def carried_out(case: Case, scratch: Path) -> tuple[int | str, str, float, int]:
    """Exit code or what else ended it, standard error, seconds of the processor, peak memory
    (bytes).
    """
    began = time.monotonic()
    process = os.fork()
    if process == 0:
        _child(case, scratch)
    while True:
        done, status, used = os.wait4(process, os.WNOHANG)
        if done:
            break
        if time.monotonic() - began > WAIT_S:
            os.kill(process, signal.SIGKILL)
            _, _, used = os.wait4(process, 0)
            return "hang", "", WAIT_S, used.ru_maxrss * 1024
        time.sleep(0.002)
    code: int | str = os.WEXITSTATUS(status)
    if os.WIFSIGNALED(status):
        if os.WTERMSIG(status) == signal.SIGXCPU:
            return "hang", "", SECONDS, used.ru_maxrss * 1024
        code = f"signal {os.WTERMSIG(status)}"
    text = (scratch / "err").read_text("utf-8", "replace")
    return code, text, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024


def _child(case: Case, scratch: Path) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (int(SECONDS), int(SECONDS) + 5))
    code: Any = 99
    try:
        for name, descriptor in (("out", 1), ("err", 2)):
            there = os.open(scratch / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            os.dup2(there, descriptor)
        sys.stdout = open(1, "w", encoding="utf-8", errors="replace", closefd=False)
        sys.stderr = open(2, "w", encoding="utf-8", errors="replace", closefd=False)
        try:
            code = verb(list(case.words))
        except SystemExit as end:
            code = end.code
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        import traceback

        with contextlib.suppress(BaseException):
            os.write(2, traceback.format_exc().encode())
    finally:
        os._exit(code if isinstance(code, int) else 1)


def wrong(code: int | str, text: str, old: bool) -> str:
    """What is wrong with how a case ended; empty for nothing."""
    if "Traceback" in text:
        return "traceback"
    if code == DEFECT:
        return "defect"
    if code not in GOOD:
        return f"ended with {code}"
    lines = text.splitlines()
    if code == 2 and (len(lines) != 1 or len(lines[0]) > LINE or not lines[0].isprintable()):
        return "error of several lines, or a long one"
    return "" if old else "old output harmed"


def kept(output: Path) -> bool:
    """Whether the output of an earlier run is as it was."""
    return output.is_file() and output.read_bytes() == b"old"


def warm(good: Path, out: Path) -> None:
    """Compile what the cases run: a compilation is no hang of theirs."""
    cloud = str(good / "b.ply")
    program("filter", cloud, "-o", str(out / "warm.ply"))
    program("volume", cloud, "--base", "ground")
    program("volume", cloud, "--level", "0", "-o", str(out / "warm"), "--as", "all")
    program("tin", cloud, "-o", str(out / "warm.ply"))
    program("body", cloud, "-o", str(out / "warm.obj"))


def fuzz(count: int, seed: int, keep: Path | None = None) -> dict[str, Any]:
    """``count`` cases: how they ended, and those that ended as none should."""
    for module in WORK:  # once, for all that are forked from here
        importlib.import_module(f"ladar_volume.cli.{module}")
    for module in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    random_, ends, seen = random.Random(seed), Counter[str](), []
    verbs = Counter[str]()
    slowest = most = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "good").mkdir()
        known, folders = seeds(folder / "good"), kinds(folder / "folders")
        warm(folder / "good", folder)
        every = [*known, *folders]
        for number in range(count):
            if (kind := random_.choice(every)) in folders:
                one = of_folder(folders[kind], folder, random_)
            else:
                one = case(kind, known, folder, random_)
            if one.output is not None:
                one.output.parent.mkdir(parents=True, exist_ok=True)
                one.output.write_bytes(b"old")
            code, text, seconds, memory = carried_out(one, folder)
            harmed = one.output is not None and code not in (0, 3)
            old = not harmed or (one.output is not None and kept(one.output))
            if code == 1 and one.words[0] == "sites":
                code = 0  # its table names what failed
            said = "hang" if code == "hang" else wrong(code, text, old)
            ends[said or f"exit {code}"] += 1
            verbs[one.words[0]] += 1
            slowest, most = max(slowest, seconds), max(most, memory)
            if said:
                words = [w[:100] for w in one.words]
                print(f"{number}: {said}: {one.words[:3]}: {text[-300:]}", file=sys.stderr)
                seen.append({"case": number, "what": said, "words": words, "err": text[-700:]})
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    for file in one.files:
                        shutil.copy(file, keep / f"{seed}_{number}{file.suffix}")
            if one.output is not None:
                one.output.unlink(missing_ok=True)
    return {
        "cases": count,
        "verbs": dict(verbs.most_common()),
        "ends": dict(ends.most_common()),
        "slowest_s": round(slowest, 1),
        "most_memory_bytes": int(most),
        "wrong": seen,
    }


GOALS = {
    "tracebacks, defects, hangs, long errors, harmed outputs": (0.0, 0.0),
    "slowest case (s)": (0.0, SECONDS),
    "most memory (MB)": (0.0, 4000.0),
}


def run() -> dict[str, float | int | str]:
    """A thousand cases."""
    out = fuzz(1_000, 1)
    return {
        "mutated files and options": out["cases"],
        "tracebacks, defects, hangs, long errors, harmed outputs": len(out["wrong"]),
        "slowest case (s)": out["slowest_s"],
        "most memory (MB)": out["most_memory_bytes"] / 1e6,
    }


def main() -> int:
    """Print what was found as JSON."""
    parser = argparse.ArgumentParser(description="mutated files and options")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--corpus", type=Path)
    arguments = parser.parse_args()
    out = fuzz(arguments.count, arguments.seed, arguments.corpus)
    print(json.dumps(out, indent=1))
    return int(bool(out["wrong"]))


if __name__ == "__main__":
    sys.exit(main())
