"""Memory that a long-running node no longer needs goes back to the system. glibc's allocator keeps
it otherwise: its arenas, one or more per thread, grow to the peak of each thread and stay there,
and large blocks that were freed once are cut from the heap from then on. Elsewhere these calls do
nothing. Fast DDS, too, keeps a buffer for every message that ever waited, where it is not told
otherwise.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import importlib
import os
import sys
from pathlib import Path

from ladar_volume.process.import_guard import hide_module

#: mallopt's numbers for what may stay free at a heap's end, by how much that grows, for the size
#: from which a block is a mapping of its own, for how many there may be, and for the greatest
#: number of arenas (malloc.h).
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -2, -3, -4, -8
#: Blocks from this size on are mapped, and unmapped when freed: messages and the large arrays of a
#: surface. Each of their pages is cleared anew, a twelfth of the time of an estimate where blocks
#: of a quarter of this size are mapped.
MAPPED_BYTES = 1 << 22
#: The same once a process holds so much: the blocks of a large map come and go in every thread, and
#: leave holes of a hundred megabytes in a heap.
MAPPED_OF_LARGE, LARGE_BYTES = 1 << 18, 500 << 20
#: Bytes that stay free at a heap's end between two calls of :func:`release_memory`: small blocks
#: come and go all the time, and clearing returned pages anew takes a tenth of an estimate's time.
KEPT_BYTES = 1 << 24
#: madvise's word for pages that are not needed now (mman.h): those of a file are read again when
#: they are.
_MADV_DONTNEED = 4
#: What numba asks for with its first kernel, to take products of matrices by it, which no kernel
#: here does: all of SciPy's linear algebra.
BLAS = "scipy.linalg.cython_blas"
#: Where Fast DDS is told what it reads, and the ROS middleware that it is to leave buffers to that;
#: and what is read.
PROFILES, FROM_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML"
FREED = Path(__file__).with_name("fastdds.xml")
#: How often a node gives memory back, s: the call takes milliseconds.
GIVE_BACK_S = 5.0
#: Blocks below this size come and go in the heap of a worker, the most that glibc allows, and twice
#: as much stays free at its end.
IN_HEAP_BYTES = 1 << 25
#: By how much the heap of a process that keeps what it frees grows.
GROWN_BYTES = 1 << 26


def few_arenas() -> None:
    """Let all threads share two arenas and map large blocks; to be called before they start."""
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_ARENA_MAX, 2)
        libc.mallopt(_M_MMAP_THRESHOLD, MAPPED_BYTES)
        libc.mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)


@functools.cache
def keep_blocks() -> None:
    """Let arrays come and go in the heap, once in a process. Dask has its workers return what is
    free at once, and glibc then maps every block of 128 KB: a fifth of a worker's time goes into
    pages that are cleared anew.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, IN_HEAP_BYTES)
        libc.mallopt(_M_TRIM_THRESHOLD, 2 * IN_HEAP_BYTES)


def keep_freed() -> None:
    """Let a process that reads a file, works on it and ends keep what it frees, arrays of any size
    too: a page that goes back to the system is cleared anew when it comes again, which took a third
    of the time of a cloud of 10⁷ points.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_MAX, 0)
        libc.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
        libc.mallopt(_M_TOP_PAD, GROWN_BYTES)


def free_buffers() -> None:
    """Have Fast DDS free the buffers of messages that were taken; to be called before ROS starts.
    Profiles of one's own are left alone, and should say the same.
    """
    if PROFILES not in os.environ and FROM_PROFILES not in os.environ:
        os.environ.update({PROFILES: str(FREED), FROM_PROFILES: "1"})


def resident_bytes() -> int:
    """What this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def return_free() -> None:
    """Return what is free: between two steps of a process that keeps it, of which the first leaves
    holes that are too small for the second.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def release_memory() -> None:
    """Return what is free, and see to it that what a large process frees is returned at once."""
    return_free()
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(
            _M_MMAP_THRESHOLD, MAPPED_OF_LARGE if resident_bytes() > LARGE_BYTES else MAPPED_BYTES
        )


def without_blas() -> None:
    """Let numba load without SciPy's linear algebra, a fifth of what a node without data holds; for
    a process of one's own, in which then no kernel can multiply matrices.
    """
    with hide_module(BLAS):
        importlib.import_module("numba.np.arraymath")


def unchanged_pages(smaps: str) -> list[tuple[int, int]]:
    """First address and length of each mapping of a shared library that may not be written to and
    that nothing was written to, from the text of ``/proc/self/smaps``.
    """
    out, mapping = [], (0, 0)
    for line in smaps.splitlines():
        words = line.split()
        if not words[0].endswith(":"):
            first, _, end = words[0].partition("-")
            inside = words[1][1] == "-" and len(words) > 5 and ".so" in words[-1].rpartition("/")[2]
            mapping = (int(first, 16), int(end, 16) - int(first, 16)) if inside else (0, 0)
        elif words[0] == "Anonymous:" and mapping[1] and int(words[1]) == 0:
            out.append(mapping)
    return out


def drop_code() -> None:
    """Give back the pages of libraries that are as in their files. Most ran only to import and
    compile; what runs again is read again, and mostly lies in the system's cache.
    """
    with contextlib.suppress(OSError, AttributeError):
        madvise = ctypes.CDLL(None).madvise
        for first, length in unchanged_pages(Path("/proc/self/smaps").read_text()):
            madvise(ctypes.c_void_p(first), ctypes.c_size_t(length), _MADV_DONTNEED)


def pack_modules() -> None:
    """Keep what LLVM made of each kernel's intermediate code as the few bytes it was loaded from.
    Only compiling another kernel that calls it needs that, and then has it made again; machine code
    stays as it is.
    """
    if "numba.core.codegen" not in sys.modules:
        return
    codegen, lock = (
        sys.modules["numba.core.codegen"],
        sys.modules["numba.core.compiler_lock"].global_compiler_lock,
    )
    with lock:  # what another thread loads at this moment is not yet done with its module
        for library in gc.get_objects():
            if (
                issubclass(type(library), codegen.CPUCodeLibrary)
                and getattr(library, "_shared_module", None) is not None
            ):
                bitcode = library._shared_module.as_bitcode()
                library._shared_module = None
                library._get_module_for_linking = functools.partial(
                    codegen.ll.parse_bitcode, bitcode
                )


def tidy() -> None:
    """Collect what only cycles hold, then return what is free and what only a start needs: after
    one that compiled and imported much.
    """
    pack_modules()
    gc.collect()
    release_memory()
    drop_code()
