"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ladar_volume.model.errors import OutputError
from ladar_volume.process.file_lock import lock

#: A name nobody guesses: ``.NAME.TOKEN.part``.
_TOKEN_BYTES = 8
#: How a folder is opened; 0 where folders cannot be opened at all (Windows).
_DIRECTORY = getattr(os, "O_DIRECTORY", 0)


@contextlib.contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A path to write to, of the same name in a folder of our own beside it; on the disk and
    renamed to ``path`` when the block ends well, else removed. A link at ``path`` is replaced, not
    followed.

    Raises :class:`OutputError` where it cannot be written.
    """
    try:
        with part_folder(path.parent, path.name) as part:
            with name_in_errors(part, path.parent):
                yield part / path.name
            sync(part / path.name)
            (part / path.name).replace(path)
            sync(path.parent)
    except OSError as error:
        raise unwritable(path, error) from error


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A path to create a folder at; renamed to ``path``, where nothing may be yet, when the block
    ends well, else removed. Raises :class:`OutputError`.
    """
    if os.path.lexists(path):
        raise OutputError(f"{path} exists already", reason="output_exists", value=str(path))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part_folder(path.parent, path.name) as part:
            yield part / path.name
            sync_tree(part)
            (part / path.name).rename(path)
            sync(path.parent)
    except OSError as error:
        raise unwritable(path, error) from error


@contextlib.contextmanager
def name_in_errors(part: Path, asked: Path) -> Iterator[None]:
    """Refusals of what is written to ``part`` name ``asked``, which the user knows."""
    try:
        yield
    except OutputError as error:
        text = str(error).replace(str(part), str(asked))
        raise OutputError(text, reason=error.reason, value=str(asked)) from error


def unwritable(path: Path, error: OSError) -> OutputError:
    """The refusal of the disk, by the name that was asked for."""
    return OutputError(
        f"{path}: cannot be written: {error.strerror or error}",
        reason="output_unwritable",
        value=str(path),
    )


@contextlib.contextmanager
def part_folder(parent: Path, name: str) -> Iterator[Path]:
    """A new folder in ``parent`` that nobody else may enter and whose name nobody can guess; gone
    with what is left in it when the block ends. Those that killed runs left go as well.
    """
    remove_stale(parent, name)
    part, descriptor = _locked_new(parent, name)
    try:
        yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)
        os.close(descriptor)


def _locked_new(parent: Path, name: str) -> tuple[Path, int]:
    while True:
        part = parent / f".{_short(name)}.{secrets.token_hex(_TOKEN_BYTES)}.part"
        part.mkdir(mode=0o700)
        with contextlib.suppress(FileNotFoundError, BlockingIOError):
            return part, lock_folder(part)  # else another run took it for one left behind


def _short(name: str) -> str:
    """At most 200 bytes, that a name made of it is none too long."""
    return name.encode(errors="surrogateescape")[:200].decode(errors="ignore")


def lock_folder(folder: Path) -> int:
    """A descriptor that locks a folder until it is closed. Raises BlockingIOError where another
    holds it; on disks without locks there is none.
    """
    while True:
        descriptor = _open_folder(folder)
        try:
            lock(descriptor)
        except BlockingIOError:
            os.close(descriptor)
            raise
        except OSError:
            return descriptor
        if not _DIRECTORY:
            return descriptor
        there, ours = os.stat(folder), os.fstat(descriptor)
        if (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino):
            return descriptor
        os.close(descriptor)  # exchanged for another while we waited


def _open_folder(folder: Path) -> int:
    """A folder, or where folders cannot be opened a file that stands for it among the temporary
    ones.
    """
    if _DIRECTORY:
        return os.open(folder, os.O_RDONLY | _DIRECTORY)
    name = hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()
    return os.open(
        Path(tempfile.gettempdir()) / f"ladar_volume-{name}.lock", os.O_RDWR | os.O_CREAT
    )


def owned_by_user(status: os.stat_result) -> bool:
    """Whether a file is ours; where files have no such owner (Windows) it is."""
    user = getattr(os, "geteuid", None)
    return user is None or bool(status.st_uid == user())


def remove_stale(parent: Path, name: str) -> None:
    """Remove the part folders of ``name`` that no run holds: our own, no links."""
    ours = re.compile(rf"\.{re.escape(_short(name))}\.[0-9a-f]{{{2 * _TOKEN_BYTES}}}\.part")
    with contextlib.suppress(OSError), os.scandir(parent) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):
                mine = owned_by_user(entry.stat(follow_symlinks=False))
                if ours.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False) and mine:
                    descriptor = lock_folder(Path(entry.path))
                    shutil.rmtree(entry.path, ignore_errors=True)
                    os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Have the disk confirm all files of a folder, and the folder."""
    for root, _, names in os.walk(folder):
        for name in names:
            sync(Path(root) / name)
        sync(Path(root))


def sync(path: Path) -> None:
    """Have the disk confirm a file, or, where folders can be opened, a folder's list of names."""
    if not _DIRECTORY and path.is_dir():
        return
    how = os.O_RDONLY if _DIRECTORY else os.O_RDWR  # Windows confirms only what may be written
    descriptor = os.open(path, how | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
