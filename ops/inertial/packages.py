"""Packages that only sensors need, and that users install as the extra `kinedex[imu]`."""

from __future__ import annotations

import importlib
from types import ModuleType

from kinedex.ops.errors import KinedexError


class MissingPackageError(KinedexError):
    """A package that sensors need is not installed."""


def imu_package(name: str, purpose: str) -> ModuleType:
    """Import a package of the extra.

    Parameters
    ----------
    name : str
        The module, such as scipy.signal.
    purpose : str
        What needs it, which begins the message.

    Raises
    ------
    MissingPackageError
        It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as fault:
        raise MissingPackageError(
            f"{purpose} the package {name.partition('.')[0]}, which is not installed: "
            "install it with `pip install 'kinedex[imu]'`"
        ) from fault
