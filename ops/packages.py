"""This module imports packages of optional extras on demand, with an error that names the extra to install."""

from __future__ import annotations

import importlib
from types import ModuleType

from kinedex.ops.errors import KinedexError


class MissingPackageError(KinedexError):
    """A package of an optional extra is not installed."""


def extra_package(name: str, package: str, purpose: str, extra: str) -> ModuleType:
    """Import a module of an optional package; if it is missing, the error names the extra to install.

    Parameters
    ----------
    name : str
        The module, such as scipy.signal.
    package : str
        The package as people install it, such as scipy.
    purpose : str
        The beginning of the error message, a subject with its verb: "a map of an archive needs".
    extra : str
        The extra of kinedex that installs it.

    Raises
    ------
    MissingPackageError
        The package is not installed.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as fault:
        raise MissingPackageError(
            f"{purpose} the package {package}, which is not installed: install it with `pip install 'kinedex[{extra}]'`"
        ) from fault


def imu_package(name: str, purpose: str) -> ModuleType:
    """Import a module of a package of the extra `kinedex[imu]`.

    Parameters
    ----------
    name : str
        The module, such as scipy.signal.
    purpose : str
        The beginning of the error message, a subject with its verb, as in `extra_package`.

    Raises
    ------
    MissingPackageError
        The package is not installed.
    """
    return extra_package(name, name.partition(".")[0], purpose, "imu")
