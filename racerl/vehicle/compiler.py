"""C source to a loaded library, by the system's compiler.

A library is kept in the user's cache under a hash of source, compiler and processor, so that it is built once, also
where many processes ask for it at once. It runs as code: only its user may write there, and its name holds the hash of
its content, so that a damaged one is built anew.
"""

import atexit
import ctypes
import functools
import hashlib
import logging
import os
import platform
import shutil
import signal
import stat
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from racerl.documents import alone, user_cache

log = logging.getLogger(__name__)

# fast-math lets the compiler take the vector versions of sin, atan, …; NaN still spreads through sums.
# cos is written as a shifted sin: sin and cos of one angle would be fused to a complex exponential, which has none.
FLAGS = ("-march=native", "-ffast-math", "-fopenmp-simd", "-fPIC")
# a loop over all effects has more than the thousand operands beyond which GCC would not vectorise it
WIDE = ("--param", "loop-max-datarefs-for-datadeps=100000")
THOROUGH, QUICK = ("-O3",), ("-O1", "-ftree-vectorize", "-fno-tree-slp-vectorize", *WIDE)

ABANDONED = 3600.0  # s, after which a folder that a compiler works in was left behind

_listeners: list[Callable[[], None]] = []  # called, from whichever thread, before the compiler is


@contextmanager
def telling(listener: Callable[[], None]) -> Iterator[None]:
    """Tell somebody whenever a kernel has to be compiled, for that takes seconds."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def cache_folder() -> Path:
    """Return where compiled libraries are kept; a temporary folder where others could write, or nobody can."""
    folder = user_cache("kernels")
    try:
        base = folder.parent.parent
        base.mkdir(mode=0o700, parents=True, exist_ok=True)
        if base.stat().st_mode & (stat.S_IWOTH | stat.S_ISVTX) == stat.S_IWOTH:
            raise PermissionError(f"{base} can be written by everybody")
        for part in (folder.parent, folder):
            part.mkdir(mode=0o700, exist_ok=True)
            _make_private(part)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(f"{folder} cannot be written")
        return folder
    except OSError as error:
        return _temporary(folder, str(error))


def _make_private(folder: Path) -> None:
    """Take others' permission to write from a folder, and out of it what they may have put there.

    Raises PermissionError for another user's.
    """
    facts = folder.stat()
    if facts.st_uid != os.geteuid():
        raise PermissionError(f"{folder} belongs to another user")
    if facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        folder.chmod(0o700)
        kept = [*folder.rglob("*.so")]
        log.warning("%s could be written by others; it is private now, %d kernels are built anew", folder, len(kept))
        for library in kept:
            library.unlink()


@functools.cache
def _temporary(folder: Path, why: str) -> Path:
    log.warning("kernels are not kept in %s (%s); they are built anew in every process", folder, why)
    temporary = tempfile.mkdtemp(prefix="racerl-")
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return Path(temporary)


@functools.cache
def find_compiler() -> str | None:
    """Return the C compiler's path; say once when there is none."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return path
    log.warning("no C compiler found; computing on torch, several times slower (install gcc to change that)")
    return None


def build(code: str, effort: Sequence[str] = THOROUGH) -> ctypes.CDLL | None:
    """Compile the source, or take it from the cache; None (and a line in the log) when that is not possible.

    `QUICK` takes less than half of the time; loops have to be written out for it, and vectorised by pragma. Raises
    KeyboardInterrupt where the user interrupts the compiler, in whichever thread that is.
    """
    compiler = find_compiler()
    if compiler is None:
        return None
    try:
        version = subprocess.run([compiler, "--version"], capture_output=True, check=True, timeout=30).stdout  # noqa: S603
        about = [code, *effort, *FLAGS, version.decode(errors="replace"), _processor()]
        identity = hashlib.sha256("\0".join(about).encode()).hexdigest()[:32]
        folder = cache_folder()
        library = _kept(folder, identity) or _compile([compiler, *effort, *FLAGS], code, folder, identity)
        return ctypes.CDLL(str(library))
    except (OSError, subprocess.SubprocessError) as error:
        if isinstance(error, subprocess.CalledProcessError) and error.returncode == -signal.SIGINT:
            raise KeyboardInterrupt from error
        log.warning("the kernel could not be compiled (%s); computing on torch, several times slower", error)
        return None


def _kept(folder: Path, identity: str) -> Path | None:
    """Return the library of that identity whose content is what its name says; any other is removed."""
    for path in folder.glob(f"{identity}-*.so"):
        if path.name == _name(identity, path.read_bytes()):
            return path
        log.warning("%s: is damaged; it is built anew", path)
        path.unlink(missing_ok=True)
    return None


def _name(identity: str, content: bytes) -> str:
    return f"{identity}-{hashlib.sha256(content).hexdigest()[:32]}.so"


def _compile(compiler: Sequence[str], code: str, folder: Path, identity: str) -> Path:
    """Build in a folder beside the target and rename; processes that want the same library wait for the first."""
    with alone(folder / f"{identity}.lock"), tempfile.TemporaryDirectory(dir=folder, prefix="build-") as work:
        if library := _kept(folder, identity):
            return library
        _sweep(folder)
        for listener in tuple(_listeners):
            listener()
        path, unit, built = (Path(work) / f"kernel.{suffix}" for suffix in ("c", "o", "so"))
        path.write_text(code)
        # linked without -ffast-math, which would make the whole process flush subnormal numbers to zero
        for command in (
            [*compiler, "-c", str(path), "-o", str(unit)],
            [compiler[0], "-shared", str(unit), "-o", str(built), "-lm"],
        ):
            subprocess.run(command, capture_output=True, check=True)  # noqa: S603
        library = folder / _name(identity, built.read_bytes())
        built.replace(library)
        return library


def _sweep(folder: Path) -> None:
    """Remove what compilers that were killed have left."""
    for left in folder.glob("build-*"):
        if time.time() - left.stat().st_mtime > ABANDONED:
            shutil.rmtree(left, ignore_errors=True)


def _processor() -> str:
    """Return what -march=native depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next((line for line in lines if line.startswith(("flags", "Features"))), platform.machine())
    except OSError:
        return platform.machine()
