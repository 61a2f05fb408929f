"""Fill templates and copy assets to make the files of a page; all values in templates are escaped."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from ..files.atomic import write_bytes
from .policy import policy

ASSETS = ("libraries.js", "viewer.js", "style.css", "LICENCES.txt")
TEMPLATES = Environment(
    loader=PackageLoader("cicatrix.pages"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.globals["policy"] = policy


def rendered(template: str, values: Mapping[str, Any]) -> str:
    """Return a filled template as text."""
    return TEMPLATES.get_template(template).render(**values)


def write_page(path: Path, template: str, values: Mapping[str, Any]) -> None:
    """Write a page atomically."""
    write_bytes(path, rendered(template, values).encode())


def copy_assets(folder: Path) -> None:
    """Copy scripts, style sheet and licences to ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ASSETS:
        with resources.as_file(asset(name)) as source:
            shutil.copyfile(source, folder / name)


def asset(name: str) -> Any:
    """Return a file in the package's ``assets`` folder."""
    return resources.files("cicatrix.pages") / "assets" / name
