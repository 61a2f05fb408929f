"""Description of a run in manifest.json: case, program, hashes of inputs, status, and duration of each stage."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.version import __version__
from ..files.text import sha256_of
from .progress import Seconds

MANIFEST = "manifest.json"
LIBRARIES = (
    "numpy",
    "scipy",
    "jax",
    "jaxlib",
    "equinox",
    "scikit-fem",
    "mmgpy",
    "mkl",
    "SimpleITK",
    "pydicom",
    "pydantic",
    "meshio",
    "matplotlib",
)


def new_manifest(
    case: Mapping[str, Any], seed: int, inputs: Mapping[str, Path], sources: Mapping[str, str]
) -> dict[str, Any]:
    """Make the manifest of a run before it starts; inputs have their name without folder, and their hash."""
    return {
        "program": {"name": "cicatrix", "version": __version__},
        "status": {"state": "running", "sentence": "The run has started and not ended."},
        "seed": seed,
        "case": json.loads(json.dumps(case)),
        "inputs": {key: {"name": path.name, "sha256": sha256_of(path)} for key, path in inputs.items()},
        "sources": dict(sources),
        "notes": [],
        "seconds": {},
        "python": platform.python_version(),
        "platform": platform.platform(terse=True),
        "libraries": dict(_versions()),
    }


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Read the manifest of a folder; None if the folder has none.

    Raises
    ------
    InputError
        If the file is not a valid manifest.
    """
    path = folder / MANIFEST
    if not path.is_file():
        return None
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError):
        raise InputError(f"{path} cannot be read as JSON; it is not the manifest of a run") from None
    if not _describes_a_run(manifest):
        raise InputError(f"{path} is not the manifest of a run")
    return manifest


def _describes_a_run(manifest: Any) -> bool:
    parts = ("program", "case", "inputs", "status")
    if not isinstance(manifest, dict) or not all(isinstance(manifest.get(part), dict) for part in parts):
        return False
    return {"state", "sentence"} <= manifest["status"].keys()


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """List the differences that prevent one run from resuming the other: keys of the case, changed inputs, and the version."""
    before, after = dict(flat(old["case"])), dict(flat(new["case"]))
    missing = object()
    found = [key for key in {**before, **after} if before.get(key, missing) != after.get(key, missing)]
    for key in {**old["inputs"], **new["inputs"]}:
        hashes = [which["inputs"].get(key, {}).get("sha256") for which in (old, new)]
        if hashes[0] != hashes[1]:
            found.append(f"the content of {key}")
    if old["program"] != new["program"]:
        found.append("the version of cicatrix")
    return found


def continued(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """Return the manifest of a resumed run: the earlier one with status running, and a note if library versions changed."""
    changed = [name for name, version in new["libraries"].items() if old["libraries"].get(name) != version]
    notes = [f"Resumed with other versions of {', '.join(changed)}; bytes may differ."] if changed else []
    return old | {"status": new["status"], "libraries": new["libraries"], "notes": [*old["notes"], *notes]}


def add_seconds(before: Mapping[str, Any], now: Mapping[str, Seconds]) -> dict[str, dict[str, float]]:
    """Add the seconds per stage of this session to those of earlier sessions of the run."""
    total = {name: dict(spent) for name, spent in before.items()}
    for name, spent in now.items():
        earlier = total.get(name, {"wall": 0.0, "cpu": 0.0})
        total[name] = {
            "wall": round(earlier["wall"] + spent.wall, 6),
            "cpu": round(earlier["cpu"] + spent.cpu, 6),
        }
    return total


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys of nested tables, and their values."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _versions() -> Iterator[tuple[str, str]]:
    for name in LIBRARIES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
