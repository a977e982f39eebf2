"""Outputs are the old ones or the new ones, never some of each; nothing predictable is followed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ladar_volume.io import output_set as sets
from ladar_volume.io.atomic_write import atomic_file, new_folder
from ladar_volume.io.meshfiles.mesh_files import write_mesh
from ladar_volume.io.output_set import output_set
from ladar_volume.io.results import SURVEY_FILES, write_text
from ladar_volume.model.errors import OutputError

NAMES = ("result.json", "mesh.ply", "figure.png")


def fill(folder, text, names=NAMES):
    for name in names:
        write_text(folder / name, text)


def contents(folder):
    return {p.name: p.read_text() for p in sorted(folder.iterdir()) if p.is_file()}


@pytest.fixture(params=["exchange", "subfolder", "inside", "no renameat2"])
def out(request, tmp_path, monkeypatch):
    """A folder of old results, each so that another way to replace it is taken."""
    folder = tmp_path / "out"
    folder.mkdir()
    fill(folder, "old")
    (folder / "notes.txt").write_text("mine")
    if request.param == "subfolder":
        (folder / "epoch_1").mkdir()
    elif request.param == "inside":
        monkeypatch.chdir(folder)
    elif request.param == "no renameat2":

        def refused(one, other):
            raise OSError(95, "not supported")

        monkeypatch.setattr(sets, "exchange", refused)
    return folder


def test_new_results_replace_the_old_and_leave_the_rest(out):
    with output_set(out, NAMES) as part:
        fill(part, "new", NAMES[:2])
        assert contents(out) == dict.fromkeys(NAMES, "old") | {"notes.txt": "mine"}
    # an old figure beside a new result would be a mixture
    assert contents(out) == {"mesh.ply": "new", "notes.txt": "mine", "result.json": "new"}
    assert not [p for p in (*out.iterdir(), *out.parent.iterdir()) if p.name.endswith(".part")]


def test_a_run_that_fails_harms_nothing(out):
    before = contents(out)
    for error in (RuntimeError, KeyboardInterrupt):
        with pytest.raises(error), output_set(out, NAMES) as part:
            fill(part, "new", NAMES[:2])
            raise error
    assert contents(out) == before


@pytest.mark.parametrize("step", range(8))
def test_files_in_turn_go_back_where_the_disk_refuses_one(tmp_path, monkeypatch, step):
    folder = tmp_path / "out"
    folder.mkdir()
    fill(folder, "old")
    (folder / "sub").mkdir()  # the files are renamed in turn
    renamed, rename = [], Path.rename

    def refused(source, target):
        renamed.append(source)
        if len(renamed) == step + 1:
            raise OSError(28, "No space left on device")
        return rename(source, target)

    monkeypatch.setattr(Path, "rename", refused)
    try:
        with output_set(folder, NAMES) as part:
            fill(part, "new")
        wanted = "new"
    except OutputError as error:
        assert str(error) == f"{folder}: cannot be written: No space left on device"
        wanted = "old"
    assert wanted == ("old" if step < 6 else "new")
    assert contents(folder) == dict.fromkeys(NAMES, wanted)


def test_one_run_at_a_time(tmp_path):
    with output_set(tmp_path / "out", NAMES) as part:
        fill(part, "first")
        with (
            pytest.raises(OutputError, match="another run is writing there"),
            output_set(tmp_path / "out", NAMES) as other,
        ):
            fill(other, "second")
    assert set(contents(tmp_path / "out").values()) == {"first"}
    with output_set(tmp_path / "out", NAMES) as part:
        fill(part, "third")
    assert set(contents(tmp_path / "out").values()) == {"third"}


def test_a_folder_made_in_vain_goes(tmp_path):
    with pytest.raises(RuntimeError), output_set(tmp_path / "out", NAMES):
        raise RuntimeError
    assert not list(tmp_path.iterdir())


WRITER = """
import sys
from ladar_volume.io.output_set import output_set
from ladar_volume.io.results import SURVEY_FILES
k = 0
while True:
    k += 1
    with output_set(sys.argv[1], SURVEY_FILES) as part:
        for name in SURVEY_FILES:
            (part / name).write_text(str(k))
    print(k, flush=True)
"""


def test_killed_at_any_time_a_folder_holds_one_result(tmp_path):
    rng = np.random.default_rng(5)
    folder = tmp_path / "out"
    for _ in range(8):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder)],
            stdout=subprocess.PIPE,
            cwd=Path(__file__).parents[2],
        )
        writer.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.05))
        writer.send_signal(signal.SIGKILL)
        writer.communicate()
        found = contents(folder)
        assert sorted(found) == sorted(SURVEY_FILES) and len(set(found.values())) == 1, found
    with output_set(folder, SURVEY_FILES) as part:
        write_text(part / "result.json", "last")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]  # what was left behind has gone


def test_a_link_is_replaced_and_not_followed(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("keep")
    for name in ("a.json", ".a.part.json", ".writable"):
        (tmp_path / name).symlink_to(precious)
    write_text(tmp_path / "a.json", "new")
    assert precious.read_text() == "keep"
    assert (tmp_path / "a.json").read_text() == "new" and not (tmp_path / "a.json").is_symlink()


def test_a_file_is_the_old_one_where_writing_fails(tmp_path, monkeypatch):
    v, t = np.eye(3), np.array([[0, 1, 2]], np.int32)
    for ending in ("ply", "stl", "obj", "off"):
        path = tmp_path / f"m.{ending}"
        write_mesh(path, v, t)
        old = path.read_bytes()
        with monkeypatch.context() as disk:

            def full(descriptor):
                raise OSError(28, "No space left on device")

            disk.setattr(os, "fsync", full)
            with pytest.raises(OutputError, match=f"m.{ending}: cannot be written: No space"):
                write_mesh(path, 2 * v, t)
        assert path.read_bytes() == old
    assert len(list(tmp_path.iterdir())) == 4


def test_two_names_of_the_part_are_never_the_same(tmp_path):
    seen = set()
    for _ in range(5):
        with atomic_file(tmp_path / "a.txt") as part:
            assert part.parent.stat().st_mode & 0o777 == 0o700 and part.name == "a.txt"
            seen.add(part.parent)
            part.write_text("x")
    assert len(seen) == 5


def test_a_new_folder_is_whole_or_not_there(tmp_path):
    with pytest.raises(RuntimeError), new_folder(tmp_path / "rec") as part:
        part.mkdir()
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    with new_folder(tmp_path / "rec") as part:
        part.mkdir()
        (part / "a").write_text("a")
    with pytest.raises(OutputError, match="exists already"), new_folder(tmp_path / "rec"):
        pass
    assert contents(tmp_path / "rec") == {"a": "a"}


def test_what_another_writes_meanwhile_is_kept(tmp_path, monkeypatch):
    folder, exchange = tmp_path / "out", sets.exchange
    folder.mkdir()
    fill(folder, "old")

    def late(one, other):
        (folder / "log.mcap").write_text("late")
        exchange(one, other)

    monkeypatch.setattr(sets, "exchange", late)
    with output_set(folder, NAMES) as part:
        fill(part, "new")
    assert contents(folder) == dict.fromkeys(NAMES, "new") | {"log.mcap": "late"}


class PowerCut:
    """What the disk has confirmed: bytes of files and lists of names of folders, by their inodes
    as they were when it was asked.
    """

    def __init__(self, monkeypatch):
        self.files, self.folders, self._asked = {}, {}, os.fsync
        monkeypatch.setattr(os, "fsync", self.confirm)

    def confirm(self, descriptor):
        self._asked(descriptor)
        number, path = os.fstat(descriptor).st_ino, Path(f"/proc/self/fd/{descriptor}").resolve()
        if path.is_dir():
            self.folders[number] = {p.name: p.lstat().st_ino for p in path.iterdir()}
        else:
            self.files[number] = path.read_bytes()

    def left(self, number):
        """What a power cut leaves of a folder: names, and bytes or what is in them; None for what
        was never confirmed. Parts of a run that was killed go with the next one.
        """
        if number not in self.folders:
            return self.files.get(number)
        names = self.folders[number].items()
        return {name: self.left(own) for name, own in names if not name.endswith(".part")}


def tree(folder):
    return {p.name: tree(p) if p.is_dir() else p.read_bytes() for p in folder.iterdir()}


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="paths of descriptors")
@pytest.mark.parametrize("kind", ["file", "folder", "exchanged", "in turn"])
def test_what_is_there_when_the_block_ends_is_there_after_a_power_cut(kind, tmp_path, monkeypatch):
    disk, home = PowerCut(monkeypatch), tmp_path / "home"
    home.mkdir()
    if kind == "file":
        with atomic_file(home / "a.txt") as path:
            path.write_bytes(b"new" * 100)
    elif kind == "folder":
        with new_folder(home / "made") as path:
            (path / "deep").mkdir(parents=True)
            (path / "deep" / "a.txt").write_bytes(b"new")
    else:
        (home / "out").mkdir()
        if kind == "in turn":
            monkeypatch.setattr(sets, "_try_exchange", lambda *given: False)
        with output_set(home / "out", ["a.txt", "b.txt"]) as part:
            for name in ("a.txt", "b.txt"):
                (part / name).write_bytes(name.encode() * 50)
    monkeypatch.undo()
    place = home / "out" if kind == "in turn" else home
    assert tree(place)
    assert disk.left(place.stat().st_ino) == tree(place)
