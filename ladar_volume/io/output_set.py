"""A folder of results as one thing: after a run it holds the old results or the new ones, never
some of each.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from ladar_volume.io.atomic_write import (
    lock_folder,
    name_in_errors,
    part_folder,
    sync,
    sync_tree,
    unwritable,
)
from ladar_volume.model.errors import OutputError

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


@contextlib.contextmanager
def output_set(path: str | Path, names: Sequence[str]) -> Iterator[Path]:
    """A folder to write results to; when the block ends well they take the place of those in
    ``path``, else ``path`` stays as it was. Nobody else may write to ``path`` meanwhile.

    names : all files that such results may consist of, the one that stands for them first. Those
        that were not written are removed from ``path``; its other files stay.
    Raises :class:`OutputError` where the folder cannot be written, or another run writes to it.
    """
    asked = Path(path)
    with contextlib.ExitStack() as stack:
        try:
            folder = _make_folder(asked, stack)
            stack.callback(os.close, lock_folder(folder))
            parent = folder.parent if _may_be_exchanged(folder) else folder
            part = stack.enter_context(part_folder(parent, folder.name))
        except BlockingIOError as error:
            raise OutputError(
                f"{asked}: another run is writing there: wait for it, or give another folder",
                reason="output_locked",
                value=str(path),
            ) from error
        except OSError as error:
            raise unwritable(asked, error) from error
        with name_in_errors(part, asked):
            yield part
        try:
            _commit(part, folder, names)
        except OSError as error:
            raise unwritable(asked, error) from error


def _make_folder(asked: Path, stack: contextlib.ExitStack) -> Path:
    """The folder, with no link in its path; where it had to be made, it goes when it stays
    empty.
    """
    new = not asked.exists()
    asked.mkdir(parents=True, exist_ok=True)
    folder = asked.resolve()
    if new:

        def remove_if_empty() -> None:
            with contextlib.suppress(OSError):
                folder.rmdir()

        stack.callback(remove_if_empty)
    return folder


def _may_be_exchanged(folder: Path) -> bool:
    """Whether a sibling can take the folder's place: nobody's working directory lies in it that we
    know of, it is ours, and no mount point.
    """
    if not hasattr(os, "geteuid"):
        return False  # no exchange of folders there (Windows)
    status = folder.stat()
    return (
        os.access(folder.parent, os.W_OK | os.X_OK)
        and folder not in _working_folders()
        and not os.path.ismount(folder)
        and (status.st_uid, status.st_gid) == (os.geteuid(), os.getegid())
    )


def _working_folders() -> Sequence[Path]:
    try:
        return (Path.cwd(), *Path.cwd().parents)
    except FileNotFoundError:
        return ()


def _commit(part: Path, folder: Path, names: Sequence[str]) -> None:
    written = os.listdir(part)
    sync_tree(part)
    replaced = list(dict.fromkeys((*names, *written)))
    if part.parent == folder or not _try_exchange(part, folder, replaced):
        _one_by_one(part, folder, replaced, written)
    sync(folder)


def _try_exchange(part: Path, folder: Path, replaced: Sequence[str]) -> bool:
    """Put the new folder in the place of the old one in one step. False where that cannot be done;
    then nothing has changed.
    """
    others = [name for name in os.listdir(folder) if name not in replaced]
    linked: list[Path] = []
    try:
        if any(stat.S_ISDIR((folder / name).lstat().st_mode) for name in others):
            return False  # folders cannot be in two places
        for name in others:
            os.link(folder / name, part / name, follow_symlinks=False)
            linked.append(part / name)
        part.chmod(stat.S_IMODE(folder.stat().st_mode))
        exchange(part, folder)
    except OSError:
        for path in linked:
            path.unlink(missing_ok=True)
        return False
    for name in os.listdir(part):  # what others wrote to the old folder while we looked
        if name not in replaced and not os.path.lexists(folder / name):
            (part / name).rename(folder / name)
    sync(folder.parent)
    return True


def exchange(one: Path, other: Path) -> None:
    """Two paths change places (renameat2(2)). Raises OSError, also where the system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError as error:
        raise OSError("no renameat2") from error
    paths = os.fsencode(one), os.fsencode(other)
    if rename(_AT_FDCWD, paths[0], _AT_FDCWD, paths[1], ctypes.c_uint(_RENAME_EXCHANGE)):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _one_by_one(part: Path, folder: Path, replaced: Sequence[str], written: Sequence[str]) -> None:
    """Put the old files aside, the one that stands for all first; then the new ones in place, that
    one last. Where it fails, all goes back.
    """
    aside = part / ".old"
    aside.mkdir()
    moved: list[tuple[Path, Path]] = []
    try:
        for name in replaced:
            if os.path.lexists(folder / name):
                (folder / name).rename(aside / name)
                moved.append((aside / name, folder / name))
        for name in sorted(written, key=replaced.index, reverse=True):
            (part / name).rename(folder / name)
            moved.append((part / name, folder / name))
    except BaseException:
        for source, target in reversed(moved):
            target.rename(source) if source.parent == part else source.rename(target)
        raise
