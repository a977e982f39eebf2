"""What a command, and all processes below it, take while it runs."""

from __future__ import annotations

import random
import signal
import subprocess
import threading
import time

import psutil


class Watched:
    """Memory, bytes, and CPU time, s, of a command from now on. Not every process below it is
    waited for by its parent, so that the system does not add up their times. kill_after : s, when
    one of its workers is killed, once
    """

    def __init__(self, process: subprocess.Popen[str], kill_after: float | None = None) -> None:
        self.together = self.largest = self.killed = 0
        self._cpu: dict[int, float] = {}
        self._process, self._kill_at = process, kill_after
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    @property
    def cpu_s(self) -> float:
        """CPU time of all, s."""
        return sum(self._cpu.values())

    def join(self) -> None:
        """Until the command has ended."""
        self._thread.join()

    def _watch(self) -> None:
        began = time.monotonic()
        while self._process.poll() is None:
            tree, sizes = self._tree(), [0]
            for one in tree:
                try:
                    sizes.append(one.memory_info().rss)
                    self._cpu[one.pid] = sum(one.cpu_times()[:2])
                except psutil.Error:
                    continue
            self.together = max(self.together, sum(sizes))
            self.largest = max(self.largest, *sizes)
            if self._kill_at is not None and time.monotonic() - began > self._kill_at:
                self._kill_one(tree)
            time.sleep(0.1)

    def _tree(self) -> list[psutil.Process]:
        try:
            root = psutil.Process(self._process.pid)
            return [root, *root.children(recursive=True)]
        except psutil.Error:
            return []

    def _kill_one(self, tree: list[psutil.Process]) -> None:
        try:
            servers = {p.pid for p in tree if "multiprocessing.forkserver" in " ".join(p.cmdline())}
            workers = [p for p in tree if p.ppid() in servers]
        except psutil.Error:
            return
        if workers:
            random.choice(workers).send_signal(signal.SIGKILL)
            self.killed, self._kill_at = self.killed + 1, None
