"""``ladar_volume <verb>``. An error is one line on standard error and exit code 2."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

from ladar_volume.cli.arguments.lines import Parser, one_line, printable, shown_name
from ladar_volume.cli.help.examples import add_examples
from ladar_volume.cli.help.near_misses import verbs_of
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.process.memory import keep_freed
from ladar_volume.process.switch import own_process
from ladar_volume.version import version

#: Verbs: name → module with add_parser(subparsers), loaded only when asked for. What a verb does
#: is loaded when it does it.
MODULES = {
    "replay": "ladar_volume.cli.arguments.replay",
    "filter": "ladar_volume.cli.arguments.filter",
    "simulate": "ladar_volume.cli.arguments.simulate",
    "tin": "ladar_volume.cli.arguments.tin",
    "volume": "ladar_volume.cli.arguments.volume",
    "study": "ladar_volume.cli.studies.study",
    "up": "ladar_volume.cli.arguments.up",
    "register": "ladar_volume.cli.arguments.register",
    "body": "ladar_volume.cli.arguments.body",
    "calibrate": "ladar_volume.cli.arguments.calibrate",
    "diff": "ladar_volume.cli.arguments.diff",
    "plan": "ladar_volume.cli.arguments.plan",
    "epochs": "ladar_volume.cli.arguments.epochs",
    "export": "ladar_volume.cli.arguments.outputs.export",
    "tiles": "ladar_volume.cli.arguments.scale.tiles",
    "sites": "ladar_volume.cli.arguments.scale.sites",
}

#: Verbs that hold whole clouds, and end with their result.
OF_CLOUDS = ("volume", "tin", "filter", "body", "diff", "register")
#: Set in the environment, a defect ends with its traceback.
TRACEBACK = "LADAR_VOLUME_TRACEBACK"
#: Extras of the package by the module that they bring.
EXTRAS = {
    "pymavlink": "mavlink",
    "open3d": "sim",
    "rclpy": "ros",
    "starlette": "page",
    "uvicorn": "page",
    "shtab": "completion",
    "rasterio": "geo",
    "ezdxf": "geo",
    "pye57": "geo",
    "pyogrio": "geo",
    "shapely": "geo",
    "velodyne_decoder": "velodyne",
    "dpkt": "velodyne",
    "dask": "scale",
    "distributed": "scale",
}
#: What ``--quiet`` does.
QUIET = "print errors and --json alone"
#: Exit code of a defect (sysexits' EX_SOFTWARE).
DEFECT = 70


def _info(arguments: argparse.Namespace) -> int:
    from ladar_volume.io.drivers.packet_capture import open_recording

    with open_recording(arguments.bag) as bag:
        topics = {
            name: {"type": kind, "messages": count} for name, (kind, count) in bag.topics().items()
        }
        facts: dict[str, Any] = {
            "path": str(arguments.bag),
            "duration_s": bag.duration_s,
            "start_ns": bag.start_ns,
        }
        facts |= {"topics": topics, "roles": bag.roles()}
    if arguments.json:
        print(json.dumps(facts, indent=1))
        return 0
    from rich.console import Console
    from rich.table import Table

    table = Table(
        "topic",
        "type",
        "messages",
        "used as",
        title=f"{shown_name(arguments.bag)}: {facts['duration_s']:.1f} s",
        title_justify="left",
    )
    used = {topic: role for role, topic in facts["roles"].items()}
    for name, topic in topics.items():
        cells = (shown_name(name), shown_name(topic["type"]), f"{topic['messages']:,}")
        table.add_row(*cells, used.get(name, ""))
    Console().print(table)
    return 0


def _check_config(arguments: argparse.Namespace) -> int:
    from ladar_volume.io.config import dump_config, read_config

    parameters = read_config(arguments.file, arguments.set)
    if arguments.show:
        print(dump_config(parameters), end="")
    else:
        print(f"{printable(str(arguments.file))}: good")
    return 0


def _completion(arguments: argparse.Namespace) -> int:
    import shtab

    print(shtab.complete(make_parser(None), arguments.shell))
    return 0


def make_parser(wanted: str | None) -> argparse.ArgumentParser:
    """The parser of the command line; of the verbs only ``wanted`` has its options, none for an
    empty word, or all for None.
    """
    parser = Parser(
        prog="ladar_volume", description="Volumes measured by LiDAR, with error bars one can trust."
    )
    parser.add_argument("--version", action="version", version=f"ladar_volume {version()}")
    parser.add_argument("--quiet", action="store_true", help=QUIET)
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, module in MODULES.items():
        if wanted in (name, None):
            importlib.import_module(module).add_parser(verbs)
            add_examples(name, verbs.choices[name])
        else:
            verbs.add_parser(name, help=SUMMARIES[name], add_help=False)
    info = verbs.add_parser("info", help="what a recording holds")
    info.add_argument("bag", type=Path)
    info.add_argument("--json", action="store_true")
    info.set_defaults(run=_info)
    check = verbs.add_parser("check-config", help="check a parameter file")
    check.add_argument("file", type=Path)
    check.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    check.add_argument(
        "--show", action="store_true", help="print the whole effective configuration"
    )
    check.set_defaults(run=_check_config)
    complete = verbs.add_parser("completion", help="completion of words for a shell")
    complete.add_argument("shell", choices=("bash", "zsh", "tcsh"))
    complete.set_defaults(run=_completion)
    _quiet_behind(parser)
    return parser


def _quiet_behind(parser: argparse.ArgumentParser) -> None:
    """--quiet behind each verb, and behind its own verbs, as before it."""
    for each in verbs_of(parser).values():
        each.add_argument("--quiet", action="store_true", default=argparse.SUPPRESS, help=QUIET)
        _quiet_behind(each)


def _print_refusal(text: str, code: int) -> int:
    print(one_line(f"ladar_volume: {text}"), file=sys.stderr)
    return code


def defect(error: Exception) -> str:
    """What to say of an exception that nobody foresaw, and where it happened."""
    at = traceback.extract_tb(error.__traceback__)
    here = next((f for f in reversed(at) if "ladar_volume" in f.filename), at[-1])
    where = f"{Path(here.filename).name}:{here.lineno}"
    words = one_line(str(error), 120)
    return (
        f"a defect of the program, please report it: {type(error).__name__} in {where}: "
        f"{words} ({TRACEBACK}=1 shows more)"
    )


def missing_extra(error: Exception) -> str:
    """What to install for a module that an extra brings; empty for any other error."""
    name = (error.name or "").split(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if name not in EXTRAS:
        return ""
    return f"needs {name}, which is not installed: pip install 'ladar_volume[{EXTRAS[name]}]'"


class TerminationSignal(KeyboardInterrupt):
    """SIGTERM."""


@contextmanager
def orderly_end() -> Iterator[None]:
    """SIGTERM ends what runs as Ctrl-C does: processes that a verb has started end with it, files
    are closed.
    """

    def end(number: int, frame: object) -> None:
        raise TerminationSignal

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def quiet_output(arguments: argparse.Namespace) -> Iterator[None]:
    """With ``--quiet`` nothing but JSON goes to standard output, and no progress is shown."""
    if not arguments.quiet:
        yield
        return
    os.environ["TERM"] = "dumb"  # no progress on standard error either
    if getattr(arguments, "json", False) or arguments.verb == "completion":
        yield
        return
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        yield


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code."""
    own_process()
    words = list(sys.argv[1:] if argv is None else argv)
    verb = next((w for w in words if not w.startswith("-")), "")
    parser = make_parser(verb)
    if lost := next((w for w in words if w.startswith("--") and w.endswith("=--")), None):
        parser.error(f"{lost}: no value")  # argparse takes it for an empty list
    arguments: Any = parser.parse_args(words)
    if argv is None and verb in OF_CLOUDS:  # a program of its own
        keep_freed()
    try:
        with orderly_end(), quiet_output(arguments):
            return int(arguments.run(arguments))
    except LadarVolumeError as error:
        return _print_refusal(str(error), 2)
    except MemoryError:
        return _print_refusal(
            "larger than the memory of this computer: give a smaller part of it", 2
        )
    except BrokenPipeError:
        return 141  # who read the output has left
    except Exception as error:
        if TRACEBACK in os.environ:
            raise
        if words_of_missing := missing_extra(error):
            return _print_refusal(f"{verb} {words_of_missing}", 2)
        return _print_refusal(defect(error), DEFECT)
    except KeyboardInterrupt as end:
        how = "terminated" if isinstance(end, TerminationSignal) else "interrupted"
        print(f"ladar_volume: {how}", file=sys.stderr)
        return 143 if isinstance(end, TerminationSignal) else 130


if __name__ == "__main__":
    sys.exit(main())
