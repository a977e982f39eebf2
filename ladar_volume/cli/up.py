"""``ladar_volume up``: the nodes, live or over a recording."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rich.console import Console
from rich.progress import Progress

from ladar_volume.cli.arguments.work import config_for
from ladar_volume.cli.replay import show_bodies, topics_by_role, write_outputs
from ladar_volume.cli.tables.result_table import show_result
from ladar_volume.cli.verdict_lines import exit_code
from ladar_volume.io import results
from ladar_volume.io.bags import ROLES, wanted_topics
from ladar_volume.io.config import dump_config, read_config
from ladar_volume.io.drivers.packet_capture import open_recording
from ladar_volume.io.output_set import output_set
from ladar_volume.io.surveys import read_survey
from ladar_volume.model.errors import ConfigurationError, short_repr
from ladar_volume.model.parameters import Parameters
from ladar_volume.process.numpy_names import hide_numpy_tools
from ladar_volume.process.private_graph import join_private_graph
from ladar_volume.volume.estimator import VolumeEstimator

if TYPE_CHECKING:  # ROS is loaded where the graph begins
    from ladar_volume.nodes.graph import Graph
    from ladar_volume.page.feed import Feed
    from ladar_volume.page.foxglove_live import LiveTopics

#: Folder of what volume_node saves, in the scratch folder.
SAVED = "saved"
#: How long the answer may take, s: the first closed bodies compile their kernels.
VOLUME_S, BODIES_S = 60.0, 900.0
#: A recording's graph loses no message: overrides of a played survey.
LOSSLESS = ("node.input_reliability=reliable", "node.input_depth=2000")


def ros_arguments(arguments: argparse.Namespace) -> list[str]:
    """What follows ``--ros-args``; live, ``--topic role=topic`` as a remapping. Raises
    :class:`ConfigurationError` for a role that there is not.
    """
    topics = topics_by_role(arguments.topic)
    if unknown := set(topics) - set(ROLES):
        raise ConfigurationError(
            f"--topic {short_repr(min(unknown))}: roles are {', '.join(ROLES)}", value=unknown
        )
    given = list(arguments.ros_args)
    if arguments.play is None:
        for role, topic in topics.items():
            given += ["-r", f"{ROLES[role][1]}:={topic}"]
    return given


def parameters_of(arguments: argparse.Namespace) -> Parameters:
    """The parameters of the nodes: a recording's own, a given file's, and overrides."""
    overrides = list(arguments.set)
    config = arguments.config
    if arguments.play is not None:
        overrides = [*LOSSLESS, *overrides]
        config = config_for(arguments.play, arguments.config)
    if arguments.log_all:
        if arguments.log is None:
            raise ConfigurationError("--log-all goes with --log")
        overrides.append("logger.all=true")
    if arguments.mavlink is not None:
        overrides.append(f"mavlink.url={arguments.mavlink}")
    return read_config(config, overrides)


def run(arguments: argparse.Namespace) -> int:
    """Start the graph; play, wait, print and save, or run until interrupted. With ``--warm``
    compile the kernels and end.
    """
    if arguments.warm:
        return compile_all()
    if arguments.play is not None:
        join_private_graph()  # a recording's graph is this computer's own affair
    parameters = parameters_of(arguments)
    folder = results.output_folder(arguments.output)
    console = Console(stderr=arguments.json)
    with tempfile.TemporaryDirectory() as scratch:
        result = graph_result(arguments, parameters, console, Path(scratch))
        with output_set(folder, results.SURVEY_FILES) as part:
            write_saved(Path(scratch) / SAVED, part, result, arguments)
    if arguments.json:
        print(results.json_text(result), end="")
    else:
        show_result(console, result)
        show_bodies(console, result.get("closed_bodies", []))
        console.print(f"written to {folder}/")
    return exit_code(arguments, result["verdict"])


def compile_all() -> int:
    """Compile what the nodes run, with progress on stderr."""
    from ladar_volume.compile_kernels import main

    code = main(())
    print("the kernels are ready", file=sys.stderr)
    return code


def write_saved(
    saved: Path, folder: Path, result: dict[str, Any], arguments: argparse.Namespace
) -> None:
    """The files of ``replay``, of the survey that volume_node saved."""
    survey = read_survey(saved)
    estimator = VolumeEstimator.from_updates(survey.parameters, survey.navigation, survey.updates)
    estimate = estimator.estimate(naive=False)
    write_outputs(
        folder,
        estimate,
        estimator.epoch(),
        result,
        arguments.play.name,
        figure=not arguments.no_figure,
    )
    if not arguments.no_figure:
        from ladar_volume.report.survey_report import write_survey_report

        write_survey_report(folder / "report.html", estimate, estimator.epoch(), result, ())
    if (saved / "bodies.ply").is_file():
        shutil.copyfile(saved / "bodies.ply", folder / "bodies.ply")


def graph_result(
    arguments: argparse.Namespace, parameters: Parameters, console: Console, scratch: Path
) -> dict[str, Any]:
    """The volume of a recording played through the nodes, with its files in the scratch folder;
    live they run until interrupted.
    """
    nodes_own = parameters
    if arguments.play is not None:  # live ~/save goes where the configuration says
        node = dataclasses.replace(parameters.node, output_folder=str(scratch / SAVED))
        nodes_own = dataclasses.replace(parameters, node=node)
    hide_numpy_tools()
    # the only way to ROS from here, paid for only by this verb
    from ladar_volume.nodes.graph import Graph

    with page_of(arguments, console) as feed, foxglove_of(arguments, console) as live:
        effective = scratch / "parameters.yaml"
        effective.write_text(dump_config(nodes_own), encoding="utf-8")
        graph = Graph(
            effective,
            arguments.separate,
            arguments.log,
            arguments.mavlink is not None,
            ros_arguments(arguments),
        )
        try:
            graph.show(feed, live)
            graph.wait_ready()
            if arguments.play is None:
                run_live(graph, console)
            result = played_result(graph, arguments, parameters, console)
            result["losses"] = graph.losses()
        finally:
            graph.close()
    return result


@contextlib.contextmanager
def page_of(arguments: argparse.Namespace, console: Console) -> Iterator[Feed | None]:
    """The page in the field, served while the block runs; None where it is not asked for."""
    if arguments.page is None:
        if arguments.page_token is not None:
            raise ConfigurationError("--page-token goes with --page")
        yield None
        return
    from ladar_volume.page.feed import Feed
    from ladar_volume.page.field_page import address_of, serve_page

    feed = Feed()
    with serve_page(feed, address_of(arguments.page, arguments.page_token)) as address:
        console.print(f"page: {address.url}", soft_wrap=True, markup=False)
        yield feed


@contextlib.contextmanager
def foxglove_of(arguments: argparse.Namespace, console: Console) -> Iterator[LiveTopics | None]:
    """The topics for Foxglove, served while the block runs; None where that is not asked for."""
    if arguments.foxglove is None:
        yield None
        return
    from ladar_volume.page.foxglove_live import LiveTopics, serve_topics
    from ladar_volume.page.place import place_of

    live, place = LiveTopics(), place_of(arguments.foxglove, "--foxglove")
    with serve_topics(live, place) as port:
        host = f"[{place.host}]" if ":" in place.host else place.host
        console.print(f"Foxglove: open connection ws://{host}:{port}", markup=False)
        if not place.own:
            console.print("others in this network may look on: Foxglove's protocol has no token")
        yield live


def run_live(graph: Graph, console: Console) -> NoReturn:
    """Watch the nodes until interrupted."""
    console.print("the nodes run; Ctrl-C stops them")
    while True:
        time.sleep(1.0)
        graph.check()


def played_result(
    graph: Graph, arguments: argparse.Namespace, parameters: Parameters, console: Console
) -> dict[str, Any]:
    """Play the recording; what the volume node saves, with what was played."""
    with (
        open_recording(arguments.play) as bag,
        Progress(console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        topics = bag.roles(wanted_topics(topics_by_role(arguments.topic), parameters))
        bag.require(topics, parameters.georeference.pose_source)
        task = bar.add_task(
            f"playing {arguments.play.name} at {arguments.rate:g}x through the nodes",
            total=1.0,
        )
        graph.play(bag, topics, arguments.rate, lambda share: bar.update(task, completed=share))
        bodies = parameters.volume.kind == "bodies"
        saved = graph.watcher.saved(BODIES_S if bodies else VOLUME_S)
        result: dict[str, Any] = json.loads((saved / "result.json").read_text(encoding="utf-8"))
        result["parameters"]["node"]["output_folder"] = parameters.node.output_folder
        result["input"] = {
            "path": arguments.play.name,
            "sha256": bag.digest(),
            "duration_s": bag.duration_s,
            "topics": topics,
        }
    return result
