"""Mutated files into every reader, without the verbs around them: thousands of cases a minute.

A reader gives back what it read, or refuses with an error of this library whose text has at most
so many characters. Anything else is wrong: another exception, a warning, the end of the process,
more than 4 GB of address space, more than ten seconds of the processor.

``python -m benchmarks.fuzz_readers [--count N] [--seed S] [--corpus FOLDER] [WORD ...]``; words
choose among the kinds of files. Exit code 1 where anything of this was seen.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from benchmarks.fuzz_files import MEMORY, mutated, seeds
from benchmarks.fuzz_folders import TEXTS, kinds
from ladar_volume.model.errors import LONGEST, LadarVolumeError

SECONDS = 10.0
#: Cases of one process.
BATCH = 50
Read = Callable[[Path], object]


def used_up(many: Iterable[object]) -> int:
    """How many there are, all of them made."""
    return sum(1 for _ in many)


def bag(path: Path) -> object:
    """Every message of a recording, and the returns of its clouds."""
    from ladar_volume.io.cloud_messages import returns_from_cloud
    from ladar_volume.io.drivers.packet_capture import open_recording
    from ladar_volume.model.losses import Losses
    from ladar_volume.model.parameters import GeoreferenceParameters

    parameters, losses = GeoreferenceParameters(), Losses()
    with open_recording(path) as recording:
        recording.digest()
        for raw in recording.raw():
            try:
                message = recording.message(raw)
                if raw.kind.endswith("PointCloud2"):
                    returns_from_cloud(message, parameters, losses)
            except LadarVolumeError:
                pass  # dropped and counted, as replay does
    return None


def survey(path: Path) -> object:
    """The epoch of a survey's file."""
    from ladar_volume.cli.epochs.surveys import survey_of

    return survey_of(path)


def autopilot(path: Path) -> object:
    """Every record of an autopilot's log."""
    from ladar_volume.io.mavlink.mavlink_log import MavlinkLog
    from ladar_volume.model.parameters import Parameters

    return used_up(MavlinkLog(path, Parameters().mavlink).records())


def repaired(path: Path) -> object:
    """A log as the logger repairs it."""
    from ladar_volume.io.mcap_recovery import recover

    return recover(path)


def piles(path: Path) -> object:
    """Outlines within a cloud in UTM."""
    import numpy as np
    from pyproj import CRS

    from ladar_volume.io.pointfiles.metres import MapCoordinates
    from ladar_volume.io.pointfiles.units import WORDS
    from ladar_volume.io.site.outline_files import read_outlines

    unit, utm = WORDS["m"], CRS.from_epsg(25832)
    at = MapCoordinates(utm, across=unit, up=unit, factor=(unit.metres, unit.metres))
    return read_outlines(path, at, np.array([[-5.0, -5.0], [5.0, 5.0]]))


def readers() -> dict[str, Read]:
    """The reader of each kind of file, by how the kind's name begins."""
    from ladar_volume.io.config import read_config
    from ladar_volume.io.measurements import read_measurements
    from ladar_volume.io.meshfiles.mesh_files import read_mesh
    from ladar_volume.io.pointfiles.cloud_files import read_cloud
    from ladar_volume.io.site.height_budget import read_height_errors
    from ladar_volume.io.transforms import read_transform

    return {
        "cloud": read_cloud,
        "mesh": read_mesh,
        "yaml": read_config,
        "transform": read_transform,
        "repeats": lambda path: read_measurements(path, ("roll_deg", "pitch_deg")),
        "survey": survey,
        "epoch transform": read_transform,
        "epoch": survey,
        "recording a": autopilot,
        "recording config": read_config,
        "recording metadata": lambda path: bag(path.parent),
        "recording sqlite": lambda path: bag(path.parent),
        "recording": bag,
        "log": repaired,
        "outline": lambda path: piles(next(path.parent.glob(f"o.{outline_of(path)}"))),
        "budget": read_height_errors,
    }


def outline_of(path: Path) -> str:
    """The ending of the file that is opened where this one was mutated."""
    ending = path.suffix[1:]
    return "shp" if ending in ("dbf", "shx", "prj") else ending


def sources(folder: Path) -> dict[str, tuple[Path, Read]]:
    """Good files with their readers, by kind."""
    known, found = readers(), {}
    files = seeds(folder / "good") | {
        name: kind.folder / kind.target for name, kind in kinds(folder / "folders").items()
    }
    files["log"] = files["recording mcap"]
    for name, path in files.items():
        start = next((k for k in known if name.startswith(k)), None)
        if start is not None:
            found[name] = (path, known[start])
    return found


def ended(read: Read, path: Path) -> str:
    """What is wrong with how the reader ended; empty for nothing."""
    began = time.process_time()
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            read(path)
        if said:
            return f"warning: {said[0].category.__name__}: {said[0].message}"
    except LadarVolumeError as error:
        if len(str(error)) > LONGEST:
            return f"text of {len(str(error))} characters: {str(error)[:200]}"
    except BaseException:
        return traceback.format_exc()
    taken = time.process_time() - began
    return f"took {taken:.1f} s" if taken > SECONDS else ""


def batch(known: dict[str, tuple[Path, Read]], seed: int, count: int, at: Path) -> None:
    """Cases of one process; each is written down before it begins, and what was wrong after."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (120, 125))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    random_ = random.Random(seed)
    with (at / "log").open("a", encoding="utf-8") as log:
        for number in range(count):
            kind = random_.choice(list(known))
            source, read = known[kind]
            shutil.rmtree(at / "in", ignore_errors=True)
            (at / "in").mkdir()
            for other in source.parent.iterdir() if "good" not in source.parts else [source]:
                if other.is_file():
                    shutil.copy(other, at / "in")
            path = at / "in" / source.name
            text = source.suffix in (*TEXTS, ".xyz", ".txt", ".obj", ".off")
            text |= source.name in ("a.ply", "a.pcd") or random_.random() < 0.3
            path.write_bytes(mutated(source.read_bytes(), random_, text))
            log.write(json.dumps([number, kind]) + "\n")
            log.flush()
            wrong = ended(read, path)
            log.write(json.dumps([number, kind, wrong]) + "\n")
            log.flush()
            if wrong:
                shutil.copy(path, at / f"bad_{seed}_{number}{path.suffix}")


def fuzz(count: int, seed: int, words: list[str], keep: Path | None = None) -> dict[str, Any]:
    """``count`` cases: how many of each kind, and those that ended as none should."""
    seen: list[dict[str, Any]] = []
    kinds_, done = Counter[str](), 0
    with tempfile.TemporaryDirectory() as name:
        at = Path(name)
        (at / "good").mkdir()
        known = sources(at)
        known = {k: v for k, v in known.items() if not words or any(w in k for w in words)}
        while done < count:
            size = min(BATCH, count - done)
            (at / "log").write_text("")
            process = os.fork()
            if process == 0:
                try:
                    batch(known, seed + done, size, at)
                finally:
                    os._exit(0)
            _, status = os.waitpid(process, 0)
            rows = [json.loads(line) for line in (at / "log").read_text().splitlines()]
            ends = [row for row in rows if len(row) == 3]
            if os.WIFSIGNALED(status):
                number, kind = rows[-1][:2]
                ends.append([number, kind, f"signal {os.WTERMSIG(status)}"])
                bad = next((at / "in").glob(known[kind][0].name))
                shutil.copy(bad, at / f"bad_{seed + done}_{number}{bad.suffix}")
            for number, kind, wrong in ends:
                kinds_[kind] += 1
                if wrong:
                    case = f"{seed + done}_{number}"
                    seen.append({"case": case, "kind": kind, "what": wrong[-900:]})
                    print(f"{case}: {kind}: {wrong[-300:]}", file=sys.stderr)
            done += max(len(ends), 1)
            if keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                for bad in at.glob("bad_*"):
                    shutil.move(bad, keep / bad.name)
    return {"cases": sum(kinds_.values()), "kinds": dict(kinds_.most_common()), "wrong": seen}


GOALS = {"readers that end otherwise than with a refusal": (0.0, 0.0)}


def run() -> dict[str, float | int | str]:
    """Two thousand cases."""
    out = fuzz(2_000, 1, [])
    return {
        "mutated files into readers": out["cases"],
        "readers that end otherwise than with a refusal": len(out["wrong"]),
    }


def main() -> int:
    """Print what was found as JSON."""
    parser = argparse.ArgumentParser(description="mutated files into every reader")
    parser.add_argument("words", nargs="*")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--corpus", type=Path)
    a = parser.parse_args()
    out = fuzz(a.count, a.seed, a.words, a.corpus)
    print(json.dumps(out, indent=1))
    return int(bool(out["wrong"]))


if __name__ == "__main__":
    sys.exit(main())
