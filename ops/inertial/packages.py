"""This module imports the optional packages for sensors, the extra `kinedex[imu]`."""

from __future__ import annotations

from types import ModuleType

from kinedex.ops.packages import MissingPackageError, extra_package

__all__ = ["MissingPackageError", "imu_package"]


def imu_package(name: str, purpose: str) -> ModuleType:
    """Import a module of a package of the extra `kinedex[imu]`.

    Parameters
    ----------
    name : str
        The module, such as scipy.signal.
    purpose : str
        The plural or clause that needs it, with which the error message begins.

    Raises
    ------
    MissingPackageError
        The package is not installed.
    """
    return extra_package(name, name.partition(".")[0], purpose, "imu")
