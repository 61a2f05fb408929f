"""Description of a run in manifest.json: case, program, hashes of inputs, status, and duration of each stage."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from ..core.errors import InputError
from ..core.threads import threads_of_libraries
from ..core.version import __version__
from ..files.bare_names import bare_name
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
    """Make the manifest of a run before it starts; of an input it says what it is, without its name, and its hash."""
    return {
        "program": {"name": "cicatrix", "version": __version__},
        "status": {"state": "running", "sentence": "The run has started and not ended."},
        "seed": seed,
        "case": json.loads(json.dumps(case)),
        "inputs": {key: {"name": bare_name(path), "sha256": sha256_of(path)} for key, path in inputs.items()},
        "sources": dict(sources),
        "notes": [],
        "seconds": {},
        "python": platform.python_version(),
        "platform": platform.platform(terse=True),
        "libraries": dict(_versions()),
        "threads": threads_of_libraries(),
    }


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Read the manifest of a folder; None if the folder has none.

    Raises
    ------
    InputError
        If the file is not a valid manifest.
    """
    path = folder / MANIFEST
    if path.is_dir():
        raise InputError(f"{path} is a folder; it is not the manifest of a run")
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_finite, parse_float=_finite)
    except (ValueError, OSError, RecursionError):
        raise InputError(f"{path} cannot be read as JSON; it is not the manifest of a run") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} is not the manifest of a run: it must be a table of JSON")
    try:
        return content | _Manifest.model_validate(content).model_dump()
    except ValidationError as error:
        raise InputError(f"{path} is not the manifest of a run: {_fault(error)}") from None


def _finite(text: str) -> float:
    """Return a number of JSON, which knows no NaN and no infinity."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text} is no number of JSON")
    return number


class _Status(BaseModel):
    state: Literal["running", "finished", "failed", "interrupted"]
    sentence: str


class _Spent(BaseModel):
    wall: float
    cpu: float


class _Manifest(BaseModel):
    """What is read of a manifest; the tables with a default may be missing, as in manifests of earlier versions."""

    model_config = ConfigDict(extra="allow")

    program: dict[str, Any]
    status: _Status
    case: dict[str, Any]
    inputs: dict[str, dict[str, Any]]
    sources: dict[str, str] = {}
    notes: list[str] = []
    seconds: dict[str, _Spent] = {}
    libraries: dict[str, str] = {}
    threads: dict[str, str] = {}
    found: dict[str, Any] = {}


def _fault(error: ValidationError) -> str:
    """Return what is wrong with the first part of a manifest that is not as it must be."""
    first = error.errors()[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "missing":
        return f"{name} is missing"
    return f"{name} {first['msg'][:1].lower()}{first['msg'][1:]}; got {json.dumps(first['input'])[:40]}"


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
    """Return the manifest of a resumed run: the earlier one with status running, and notes if versions or threads changed."""
    notes = []
    if changed := _changed(old["libraries"], new["libraries"]):
        notes.append(f"Resumed with other versions of {', '.join(changed)}; bytes may differ.")
    if old["threads"]:
        notes += [
            f"Resumed with {name} = {new['threads'][name]}, after {old['threads'].get(name, 'unknown')}; bytes may differ."
            for name in _changed(old["threads"], new["threads"])
        ]
    kept = {name: new[name] for name in ("status", "libraries", "threads")}
    return old | kept | {"notes": [*old["notes"], *(note for note in notes if note not in old["notes"])]}


def _changed(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    return [name for name, value in new.items() if old.get(name) != value]


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
