"""Closed bodies of volume_node (``volume.kind: bodies``): the returns they are made of, and a
thread that meshes them while the surface goes on.

A mesh takes tens of seconds: the newest bodies are those of the data when their mesh began. Between
two of them is at least as long a pause. What the survey's calibration and navigation do to them
comes from the surface when the mesh is done.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sensor_msgs.msg import PointCloud2

from ladar_volume.clouds.survey.return_store import ReturnStore
from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.message_tables import mapped_points
from ladar_volume.io.tables import decode
from ladar_volume.model.errors import LadarVolumeError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Estimate
from ladar_volume.nodes.executor_rounds import NextRound
from ladar_volume.uncertainty.volume_budget import Sources

if TYPE_CHECKING:  # the mesher is loaded by the thread that needs it
    from ladar_volume.clouds.survey.survey_bodies import MeshedReturns, SurveyBodies

#: How long an answer waits for the bodies of all data, s: the first time kernels are compiled.
ANSWER_S = 600.0
#: How long a node that ends waits for a mesh that is being made, s.
END_S = 20.0


@dataclass(frozen=True)
class MeshingOutcome:
    """What the thread found. survey : number of the survey that the returns belong to · t_ns :
    stamp of the newest of them · meshed_returns : the bodies, or error : why there are none
    """

    survey: int
    t_ns: int
    meshed_returns: MeshedReturns | None = None
    error: Exception | None = None


class ClosedBodies:
    """One per node. The worker calls :meth:`take`, :meth:`begin` and :meth:`done`; what the thread
    made comes to it through ``offer``.
    """

    def __init__(self, parameters: Parameters, offer: Callable[[str, Any], bool]) -> None:
        self._edge_m, self._offer = parameters.filter.radius_m, offer
        self._survey, self._ready = 0, MeshingOutcome(0, 0)
        #: Whether an answer waits: only it begins a mesh then.
        self.waits = False
        self._thread: threading.Thread | None = None
        #: When a mesh was begun and taken in last, s of a steady clock.
        self._began = self._ended = 0.0
        self.clear()

    def clear(self) -> None:
        """No return any more, and no body."""
        self._survey += 1
        self._store = ReturnStore(self._edge_m)
        #: Stamps of the newest mapped points, of the last that came, and of those in the bodies.
        self.newest_ns = self.last_ns = self.found_ns = 0
        self._due_ns = 0
        self.found: SurveyBodies | None = None
        self.error: Exception = VolumeError("no closed bodies yet", reason="volume_no_body")

    def take(self, message: PointCloud2) -> None:
        """Mapped points."""
        self._store.add(mapped_points(stamp_ns(message), decode(message)).r_map)
        self.last_ns = stamp_ns(message)
        self.newest_ns = max(self.newest_ns, self.last_ns)

    @property
    def running(self) -> bool:
        """Whether a mesh is being made or waits to be taken in."""
        return self._thread is not None

    def begin(self, estimate: Estimate, parameters: Parameters, immediately: bool = False) -> None:
        """Mesh the returns around what an estimate found, where there are new ones and the pause
        since the last time is over.
        """
        rested = time.monotonic() - self._ended >= self._ended - self._began
        new = self.newest_ns > self._due_ns
        if self.running or not (immediately or (new and rested and not self.waits)):
            return
        self._began, self._due_ns = time.monotonic(), self.newest_ns
        job = self._store.copy(), estimate, parameters, MeshingOutcome(self._survey, self.newest_ns)
        self._thread = threading.Thread(target=self._mesh, args=job, name="bodies", daemon=True)
        self._thread.start()

    def _mesh(
        self, store: ReturnStore, estimate: Estimate, parameters: Parameters, job: MeshingOutcome
    ) -> None:
        try:
            from ladar_volume.clouds.survey.survey_bodies import mesh_returns, returns_around

            near = returns_around(estimate, store.returns(), parameters)
            self._ready = dataclasses.replace(job, meshed_returns=mesh_returns(near, parameters))
        except Exception as error:  # the worker tells of it, and of a defect as of any other
            self._ready = dataclasses.replace(job, error=error)
        while not self._offer("bodies", None):
            time.sleep(0.1)

    def done(self, sources: Callable[[], Sources], parameters: Parameters) -> SurveyBodies | None:
        """Take in what the thread made; None of a survey that has ended meanwhile. Raises what the
        thread met.
        """
        from ladar_volume.clouds.survey.survey_bodies import with_budget

        ready, self._thread, self._ended = self._ready, None, time.monotonic()
        if ready.survey != self._survey:
            return None
        self.found, self.found_ns = None, ready.t_ns
        try:
            if ready.meshed_returns is None:
                raise ready.error or self.error
            self.found = with_budget(ready.meshed_returns, sources(), parameters)
        except LadarVolumeError as error:
            self.error = error
            raise
        except Exception as error:
            words = f"{type(error).__name__}: {error}"
            self.error = VolumeError(words, reason="message_internal_error")
            raise
        return self.found

    async def wait_for_all(self, begin: Callable[[], None]) -> None:
        """Wait for the bodies of all data so far, which ``begin`` has made."""
        self.waits, deadline = True, time.monotonic() + ANSWER_S
        try:
            await self._rest(deadline)
            begin()
            await self._rest(deadline)
        finally:
            self.waits = False

    async def _rest(self, deadline: float) -> None:
        while self.running:
            if time.monotonic() > deadline:
                raise VolumeError("closed bodies take too long", reason="volume_no_body")
            await NextRound()

    def ended(self) -> bool:
        """Wait for the thread, a while. Whether what it made is still to be taken in."""
        if self._thread is None:
            return False
        self._thread.join(END_S)
        return not self._thread.is_alive()

    def present(self) -> SurveyBodies:
        """The newest bodies. Raises why there are none."""
        if self.found is None:
            raise self.error
        return self.found

    def last_words(self) -> str:
        """The bodies when the node ends, and what they lack."""
        if self.found is None:
            return f"no closed bodies at the end: {self.error}"
        rows = ", ".join(f"{b.volume_m3:.4f} ± {b.sigma_m3:.4f} m3" for b in self.found.bodies)
        behind = (self.newest_ns - self.found_ns) * 1e-9
        late = f", without the last {behind:.1f} s: replay the log" if behind > 0.0 else ""
        return f"closed bodies at the end: {rows}{late}"

    def lines(self) -> dict[str, Any]:
        """For the diagnostics."""
        if self.found is None:
            return {"closed_bodies": str(self.error), "closed_bodies_time_ns": self.found_ns}
        return {
            "closed_bodies": len(self.found.bodies),
            "closed_bodies_m3": " ".join(f"{b.volume_m3:.4f}" for b in self.found.bodies),
            "closed_bodies_sigma_m3": " ".join(f"{b.sigma_m3:.4f}" for b in self.found.bodies),
            "closed_bodies_time_ns": self.found_ns,
            "closed_bodies_age_s": f"{(self.newest_ns - self.found_ns) * 1e-9:.1f}",
        }
