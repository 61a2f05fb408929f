"""Deferred import of packages: each is imported when a name in it is first used.

This saves time if a package is slow to import and most runs do not need it. A module declares such a package at its top::

    if TYPE_CHECKING:
        import SimpleITK as sitk
    else:
        sitk = Deferred("SimpleITK")
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Deferred:
    """Stand-in for a package: imports it at the first access to an attribute, and returns that attribute."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        """Import the package if necessary, and return its attribute of this name."""
        return getattr(import_module(self._name), attribute)
