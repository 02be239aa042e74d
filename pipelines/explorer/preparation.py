"""Preparation: what the first questions about takes would wait for is loaded while a person still looks around."""

from __future__ import annotations

import logging
from threading import Timer
from typing import TYPE_CHECKING

from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from kinedex.pipelines.explorer.archive import Archive

_LOG = logging.getLogger("kinedex.explorer")

AFTER_SECONDS = 2.0
"""The first page is served before."""


def start_preparation(archive: Archive) -> Timer:
    """Prepare in the background, some seconds from now; `cancel` of what is returned ends that.

    Parameters
    ----------
    archive : Archive
        The open store.
    """
    timer = Timer(AFTER_SECONDS, prepare, [archive])
    timer.daemon = True
    timer.start()
    return timer


def prepare(archive: Archive) -> None:
    """Open a connection of SQL, and load the compiled kernels of distance curves and their paths.

    Parameters
    ----------
    archive : Archive
        The open store.
    """
    import numpy as np

    from kinedex.ops.distances.curve_path import curve_paths
    from kinedex.ops.distances.dtw import distance_curves
    from kinedex.ops.templates.templates import QuantisedTemplate

    try:
        archive.store().sql("SELECT take_id FROM suspect_takes WHERE take_id = -1")
    except KinedexError as fault:  # such as that of an index that is still to be built
        _LOG.info("nothing was prepared: %s", fault)
    columns = np.array([1, 3], np.uint64)
    template, words = QuantisedTemplate(columns, columns), np.array([1, 3, 3], np.uint64)
    distance_curves([template], words)
    curve_paths(template, words, np.array([1], np.int64))
