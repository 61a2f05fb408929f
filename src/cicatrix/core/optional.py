"""Import of optional packages, which some functions need but which are not installed with cicatrix."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from .errors import InputError


def optional(name: str, asking: str) -> Any:
    """Import an optional package.

    Parameters
    ----------
    name : str
        Name of the package, both to import it and to install it with pip.
    asking : str
        Name of the function or file that needs the package, the subject of the error message.

    Raises
    ------
    InputError
        If the package is not installed.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise InputError(f"{asking} needs {name}: pip install {name}") from None
