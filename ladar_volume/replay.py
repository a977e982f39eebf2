"""A recording through the pipeline, offline: decoded ahead in a thread, fed in recorded order."""

from __future__ import annotations

import heapq
import math
import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from ladar_volume.clouds.survey.survey_bodies import SurveyBodies, bodies_of_survey, returns_around
from ladar_volume.georeference.fix_steps import step_doubts
from ladar_volume.georeference.mounting_check import fitting_angles, mounting_doubts
from ladar_volume.io import results
from ladar_volume.io.bags import Recording
from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.io.drivers.ring_count import RingCount
from ladar_volume.io.frames.frame_mounting import mounting_of_recording
from ladar_volume.io.frames.moving_frames import TransformPoses
from ladar_volume.io.logs.heard_live import (
    absent_words,
    heard_and_logged,
    missing_messages,
    more_than_live,
)
from ladar_volume.io.sensor_messages import (
    fix_from_message,
    imu_from_message,
    poses_from_message,
)
from ladar_volume.model.errors import (
    BagError,
    GroundError,
    InputError,
    ParameterValueError,
    SurfaceError,
    VolumeError,
)
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Estimate, Fix, Returns
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.pipeline import Engine

if TYPE_CHECKING:  # pymavlink is needed with an autopilot's log alone
    from ladar_volume.io.mavlink.mavlink_log import MavlinkLog

#: Poses of an autopilot's log this far outside the recording still bridge its ends.
POSE_MARGIN_NS = 2_000_000_000

#: A replay begins no later in the recording, s.
LATEST_S = 1e9

#: From and to which time of receipt, ns, both included.
Span: TypeAlias = tuple[int, int]
#: No time at all.
NEVER: Span = (0, -1)


@dataclass
class Replay:
    """A recording and what it is replayed with."""

    bag: Recording
    parameters: Parameters
    topics: dict[str, str]
    start_s: float = 0.0
    duration_s: float = float("inf")
    poses: MavlinkLog | None = None
    #: How many estimates are made on the way, evenly over the recording, beside the last.
    stations: int = 0

    def __post_init__(self) -> None:
        if not (0.0 <= self.start_s < LATEST_S and self.duration_s > 0.0):
            raise ParameterValueError(
                f"a replay from {self.start_s:g} s on, for {self.duration_s:g} s: give a start of "
                "0 or more, and a duration above 0"
            )
        if self.poses is not None:  # the autopilot's log stands in for the recording's own poses
            self.topics = {role: topic for role, topic in self.topics.items() if role == "cloud"}
        given = (
            {}
            if self.poses is None
            else dict.fromkeys(("fix", "imu", "odometry"), self.poses.path.name)
        )
        try:
            self.bag.require({**self.topics, **given}, self.parameters.georeference.pose_source)
        except BagError as error:
            more = absent_words(self.bag)  # a log that began after its drivers
            text = f"{error}; {more}" if more else str(error)
            raise BagError(text, reason=error.reason, value=error.value) from None
        mounted = mounting_of_recording(
            self.bag, self.topics, self.parameters, self.poses is not None
        )
        self.parameters, self.mounting = mounted.parameters, mounted.words
        self.engine = Engine(self.parameters)
        self.losses = Losses()
        self.returns = 0
        #: Counts of the filtered surface, where it was not filtered by the engine.
        self.counts: dict[str, int] | None = None
        #: Time, ns, and status of every fix, as NavSatStatus.
        self.fixes: list[tuple[int, int]] = []
        self.rings = RingCount(self.parameters.georeference.beams)
        #: Share of the recording, V and its standard deviation (m³; nan where there was none).
        self.convergence: list[tuple[float, float, float]] = []

    def run(self, progress: Callable[[float], None] = lambda share: None) -> Estimate:
        """Feed every message, finish, and estimate. A bad message is counted and left out; the good
        data around it is kept.
        """
        add = self.doors()
        for share, role, record in read_ahead(self.records()):
            if role:
                add[role](record)
            if role in ("", "cloud"):
                self.engine.step()
                progress(share)
                self._station(share)
        estimate = self.estimate_or_refuse(self.engine.finish)
        if self.stations:
            v = estimate.volume
            self.convergence.append((1.0, v.volume_m3, v.sigma_m3))
        return estimate

    def doors(self) -> dict[str, Callable[[Any], None]]:
        """Where records of each role go."""
        return {
            "fix": self._add_fix,
            "imu": self.engine.add_imu,
            "odometry": self.engine.add_odometry,
            "cloud": self._add_returns,
        }

    def estimate_or_refuse(self, estimate: Callable[[], Estimate]) -> Estimate:
        """An estimate; where there is none, the error says what was not used."""
        try:
            return estimate()
        except (SurfaceError, GroundError, VolumeError) as error:
            lost = sorted(self.all_losses().items(), key=lambda item: -item[1])[:4]
            why = ", ".join(f"{reason} {count}" for reason, count in lost)
            stage = self.engine.georeferencer
            turned = stage.mounting_check.found()
            hint = ""
            if turned is not None:
                angles = fitting_angles(turned, stage.mount.R_body_laser)
                hint = f"; the sweeps fit a scanner mounted with {angles}"
            raise type(error)(
                f"{error} ({self.returns} returns read; not used: {why or 'nothing'}{hint})",
                reason=error.reason,
            ) from error

    def _station(self, share: float) -> None:
        """An estimate on the way, where one is due; asking changes nothing of the last."""
        due = len(self.convergence) + 1
        if due > self.stations or share < due / (self.stations + 1):
            return
        try:
            v = self.engine.estimate().volume
            self.convergence.append((share, v.volume_m3, v.sigma_m3))
        except (SurfaceError, GroundError, VolumeError):  # not enough was seen
            self.convergence.append((share, math.nan, math.nan))

    def all_losses(self) -> Losses:
        """What decoding and the stages dropped."""
        losses = Losses(self.losses.as_dict())
        losses.merge(self.engine.losses)
        return losses

    def _add_fix(self, fix: Fix) -> None:
        self.fixes.append((fix.t_ns, fix.status))
        self.engine.add_fix(fix)

    def _add_returns(self, returns: Returns) -> None:
        self.returns += len(returns)
        self.rings.add(returns)
        self.engine.add_returns(returns)

    @property
    def span(self) -> Span:
        """From when to when it is replayed."""
        first = self.bag.start_ns + int(self.start_s * 1e9)
        seconds = min(self.duration_s, self.bag.duration_s - self.start_s)
        return first, first + int(seconds * 1e9)

    def records(
        self, poses: Span | None = None, clouds: Span | None = None
    ) -> Iterator[tuple[float, str, Any]]:
        """Share done, role and record of every usable message, in the order of the recording; role
        "" for nothing. Of poses and clouds only those within a span, where one is given.
        """
        first, last = self.span
        items = self.recorded_messages(poses or self.span, clouds or self.span, poses is not None)
        if self.poses is not None:
            items = heapq.merge(
                items,
                self._autopilot_records(self.poses, *(poses or self.span)),
                key=lambda item: item[0],
            )
        for t_ns, role, record in items:
            yield (t_ns - first) / max(last - first, 1), role, record

    def _autopilot_records(
        self, poses: MavlinkLog, first: int, last: int
    ) -> Iterator[tuple[int, str, Any]]:
        """Records of an autopilot's log that the pose source takes, from a little before to a
        little after.
        """
        from ladar_volume.io.mavlink.mavlink_log import ROLE

        wanted = (
            ("odometry",)
            if self.parameters.georeference.pose_source == "odometry"
            else ("fix", "imu")
        )
        for record in poses.records():
            role = ROLE[type(record)]
            if role in wanted and first - POSE_MARGIN_NS <= record.t_ns <= last + POSE_MARGIN_NS:
                yield record.t_ns, role, record
        self.losses.merge(poses.losses())

    def recorded_messages(
        self, poses: Span, clouds: Span, part: bool
    ) -> Iterator[tuple[int, str, Any]]:
        roles = {
            topic: role for role, topic in self.topics.items() if role != "cloud" or clouds != NEVER
        }
        node = self.parameters.node
        transforms = TransformPoses(node.map_frame, node.base_frame)
        decode: dict[str, Callable[[Any], list[Any]]] = {
            "fix": lambda message: [fix_from_message(message)],
            "imu": lambda message: [imu_from_message(message)],
            "odometry": lambda message: poses_from_message(message, transforms, self.losses),
            "cloud": lambda message: [
                returns_from_cloud(message, self.parameters.georeference, self.losses)
            ],
        }
        try:
            for raw in self.bag.raw(set(roles), poses if part else None):
                role = roles[raw.topic]
                first, last = clouds if role == "cloud" else poses
                if not first <= raw.t_ns <= last:
                    continue
                try:
                    for record in decode[role](self.bag.message(raw)):
                        yield raw.t_ns, role, record
                except (InputError, BagError) as error:
                    if error.reason == "bag_truncated":
                        raise
                    self.losses.add(
                        f"{role}_{error.reason}"
                        if not error.reason.startswith(role)
                        else error.reason
                    )
        except BagError as error:
            if error.reason != "bag_truncated":
                raise
            self.losses.add("bag_truncated")  # what came before the break is good data

    def closed_bodies(self, estimate: Estimate) -> SurveyBodies:
        """The closed bodies of what was replayed, about the outlines of the estimate. Raises as
        :func:`~ladar_volume.clouds.survey.survey_bodies.bodies_of_survey`.
        """
        near = returns_around(estimate, self.engine.returned.returns(), self.parameters)
        sources = self.engine.estimator.epoch().sources
        return bodies_of_survey(near, sources, self.parameters)

    def height_doubts(self) -> Verdict:
        """The autopilot's heights are above sea level where the datum's is above the ellipsoid, and
        the volume stands on a height of the map frame.
        """
        p = self.parameters
        given = p.volume.base != "ground" and math.isfinite(p.georeference.datum_height_m)
        if self.poses is None or not given or self.poses.ellipsoidal:
            return Verdict()
        words = (
            "the heights of the autopilot's log are above mean sea level, the datum's above the "
            "ellipsoid, up to 107 m apart: give mavlink.geoid_undulation_m, or volume.base ground"
        )
        return Verdict((Doubt("height_reference", words, p.georeference.datum_height_m),))

    def step_doubts(self, estimate: Estimate) -> Verdict:
        """When the fixes step, where the passes disagree."""
        step = self.engine.georeferencer.fix_steps.largest()
        return step_doubts(step, self.bag.start_ns, estimate.volume.verdict)

    def _source(self, more: dict[str, int]) -> dict[str, Any]:
        """What was replayed. more : messages by role beyond those that were heard live."""
        source: dict[str, Any] = {
            "path": self.bag.path.name,
            "sha256": self.bag.digest(),
            "duration_s": self.bag.duration_s,
            "topics": self.topics,
        }
        if self.mounting:
            source["mounting"] = list(self.mounting)
        if self.poses is not None:
            source |= {"poses": self.poses.path.name, "poses_sha256": self.poses.digest()}
            source |= {"poses_height": self.poses.height_reference}
        left_out = self.bag.left_out()
        unheard = {r: left_out[t] for r, t in self.topics.items() if t in left_out}
        source |= {"unheard_live": unheard} if unheard else {}
        return source | ({"more_than_live": more} if more else {})

    def result(self, estimate: Estimate) -> dict[str, Any]:
        """The result as plain values."""
        points = {
            "returns": self.returns,
            "mapped": self.engine.points_mapped,
            **(self.engine.filter.stats if self.counts is None else self.counts),
        }
        counted = heard_and_logged(self.bag, self.topics)
        source = self._source(more_than_live(counted))
        result = results.result_dict(
            estimate, self.parameters, self.all_losses(), self.engine.datum, points, source
        )
        doubts = self.height_doubts() + missing_messages(counted) + self.step_doubts(estimate)
        stage = self.engine.georeferencer
        doubts += mounting_doubts(stage.mounting_check.found(), stage.mount.R_body_laser)
        doubts += stage.rate_check.doubts()
        result["verdict"] = results.with_doubts(result["verdict"], doubts)
        if self.convergence:
            result["convergence"] = [
                dict(zip(("share", "volume_m3", "sigma_m3"), each, strict=True))
                for each in self.convergence
            ]
        return result | {
            "where_more_data_helps": results.more_data_dict(self.engine.estimator.more_data())
        }


def read_ahead(
    items: Iterator[tuple[float, str, Any]], depth: int = 64
) -> Iterator[tuple[float, str, Any]]:
    """Run an iterator in a thread, so that decoding and computing use both cores; errors arrive in
    order.
    """
    buffer: queue.Queue[Any] = queue.Queue(depth)
    stop = threading.Event()

    def pump() -> None:
        try:
            for item in items:
                while not stop.is_set():
                    try:
                        buffer.put(item, timeout=0.2)
                        break
                    except queue.Full:
                        continue
                if stop.is_set():
                    return
            buffer.put(None)
        except BaseException as error:  # handed to the consumer, which raises it
            buffer.put(error)

    thread = threading.Thread(target=pump, daemon=True)
    thread.start()
    try:
        while (item := buffer.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        stop.set()
