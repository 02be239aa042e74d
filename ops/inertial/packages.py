"""Packages that only sensors need, and that users install as the extra `kinedex[imu]`."""

from __future__ import annotations

from types import ModuleType

from kinedex.ops.packages import MissingPackageError, extra_package

__all__ = ["MissingPackageError", "imu_package"]


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
    return extra_package(name, name.partition(".")[0], purpose, "imu")
