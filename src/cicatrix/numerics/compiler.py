"""Settings of JAX's compiler, and a cache on disk that saves compiled code for later processes.

Importing this module turns on JAX's persistent cache. A second run then reads in 0.1 s the code that the first run compiled
in 2 s; the machine code is the same, so results are bitwise identical. All modules that compile solvers import it; modules
that only define laws do not.

The environment variable ``CICATRIX_CACHE`` gives the folder of the cache; the value ``off`` switches the cache off. If a program
has already set a cache folder for JAX, that folder is used instead.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import warnings
from contextlib import suppress
from itertools import takewhile
from pathlib import Path

import jax
import jaxlib.version

# compiler options: with fusion emitters XLA takes twice as long to compile the kernels, which run no faster
COMPILER = {"xla_cpu_use_fusion_emitters": False}

CACHE_VARIABLE, OFF = "CICATRIX_CACHE", "off"
FIRST_JAXLIB = (0, 10, 2)  # earlier versions print false warnings when reading the cache, and crash on macOS
SHORTEST_S = 0.01  # shortest compilation whose result is cached; reading it back takes 0.002 to 0.01 s
MAX_CACHE_BYTES = 500_000_000  # largest size of all caches; a kind of case takes about 0.5 MB
PROCESSOR_KEYS = ("vendor_id", "cpu family", "model", "flags", "CPU implementer", "CPU part", "Features")


def cache_folder() -> Path | None:
    """Return the folder in which compiled code is cached, or None if it is not cached.

    The base folder is ``CICATRIX_CACHE``, or ``cicatrix`` in the user's cache folder. It has one subfolder for each version of
    jaxlib and each kind of processor, because JAX would load code compiled for a processor with more instructions, log an error
    and crash at the first of these instructions.
    """
    asked = os.environ.get(CACHE_VARIABLE, "")
    base = Path(asked).absolute() if asked else _users_caches() / "cicatrix"
    version = tuple(int(part) for part in jaxlib.version.__version__.split(".")[:3] if part.isdecimal())
    if asked.lower() == OFF or version < FIRST_JAXLIB or not base.is_absolute() or not _is_writable(base):
        return None
    return base / f"jaxlib-{jaxlib.version.__version__}-{_processor()}"


def _users_caches() -> Path:
    """Return the user's cache folder on this operating system."""
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 - pathlib raises an error if there is no home
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData/Local")
    if sys.platform == "darwin":
        return home / "Library/Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")


def _is_writable(folder: Path) -> bool:
    """Return whether a folder can be created or written to."""
    there = next(path for path in (folder, *folder.parents) if os.path.exists(path))  # noqa: PTH110 - raises no error
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _processor() -> str:
    """Return a hash of the processor's model and instruction set, for which code is compiled."""
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            first = list(takewhile(str.strip, lines))
        kind = "".join(line for line in first if line.split(":")[0].strip() in PROCESSOR_KEYS)
    except OSError:
        kind = ""
    return hashlib.sha256(f"{platform.machine()} {kind or platform.processor()}".encode()).hexdigest()[:12]


def _prune(base: Path) -> None:
    """If the caches exceed ``MAX_CACHE_BYTES``, remove the least recently used files until half of that size is left."""
    kept = [
        (max(at.st_atime, at.st_mtime), at.st_size, file) for file in base.glob("*/*-cache") for at in [file.stat()]
    ]
    total = sum(size for _, size, _ in kept)
    for _, size, file in sorted(kept) if total > MAX_CACHE_BYTES else ():
        if total <= MAX_CACHE_BYTES // 2:
            break
        file.unlink(missing_ok=True)
        total -= size


def keep_compiled() -> None:
    """Turn on JAX's persistent cache of compiled code; if the cache cannot be used, JAX silently compiles again.

    Processes may read and write at the same time: JAX checks the files that it reads, and compiles again if one is incomplete.
    """
    folder = cache_folder()
    if folder is None or jax.config.jax_compilation_cache_dir is not None:
        return
    with suppress(OSError):  # another process removed a file, or the folder cannot be read
        _prune(folder.parent)
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry")
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST_S)
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")  # these caches are for GPUs only
    jax.config.update("jax_compilation_cache_dir", str(folder))


keep_compiled()
