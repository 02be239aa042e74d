"""Read takes from motion files without a store, and compute the features of arrays of positions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy.typing as npt

from kinedex.catalog.features import load_feature_set
from kinedex.library.arguments import checked
from kinedex.library.take import (
    ANALYSIS_RATE_HZ,
    FEATURES,
    Take,
    body_of_array,
    check_rate,
    feature_table,
    take_of_body,
)

if TYPE_CHECKING:
    import polars as pl


@checked
def read(
    path: str | Path,
    mapping: str | Path | None = None,
    rate: float | None = None,
    *,
    person: str = "",
    feature_set: str | Path = FEATURES,
) -> Take:
    """Read one motion file of any supported format.

    Parameters
    ----------
    path : str or Path
        A motion file: AMC (its ASF skeleton is found beside it or in a folder above), BVH, C3D, TRC, CSV, NPZ or NPY.
    mapping : str or Path, optional
        The skeleton mapping: a shipped name, or the path of a YAML file. By default the skeleton is recognised by the
        names of its joints.
    rate : float, optional
        Frames per second of the file, if it does not state them or states them wrongly.
    person : str, optional
        The person to read from a file of several persons, whom `kinedex inspect` lists.
    feature_set : str or Path, optional
        A shipped feature set, or the path of a YAML file.

    Returns
    -------
    Take
        The motion at the analysis rate of 30 frames per second, with the same words as in a store.

    Raises
    ------
    SourceError
        The file cannot be read, or holds several persons while `person` is not given; the message names file, line and
        reason.
    KinedexError
        There is no such file or mapping.
    ParameterError
        The rate is out of range.

    Examples
    --------
    >>> take = kinedex.read(motion_file)
    >>> take.joints[:3]
    ('root', 'lhip', 'lknee')
    >>> take.info["source_rate_hz"]
    120.0
    """
    from kinedex.catalog.skeletons.mappings import load_mappings
    from kinedex.pipelines.ingestion.known_files import person_name
    from kinedex.storage.formats.motion.packed_files import split_ending
    from kinedex.storage.formats.motion.reader import ReadSettings
    from kinedex.storage.formats.motion.reader_table import read_body
    from kinedex.storage.formats.motion.single_file import chosen_person, file_beside, motion_ending
    from kinedex.storage.formats.motion.unpacked_files import unpacked

    file = Path(path).expanduser()
    if rate is not None:
        check_rate(rate)
    motion_ending(file)
    beside = file_beside(file)
    features = load_feature_set(feature_set)
    mappings = load_mappings("auto" if mapping is None else str(mapping), features.joints)
    person = chosen_person(file, beside, mappings, person)
    with unpacked(file, beside) as copy:
        settings = ReadSettings(override_rate_hz=rate)
        body = read_body(copy.path, copy.skeleton, mappings, features.joints, settings, person=person)
    stem, ending = split_ending(file.name)
    about = {"source": str(file), "format": ending[1:].lower(), "skeleton_source": beside and str(beside)}
    return take_of_body(person_name(stem, person), copy.restated_body(body), features, about)


@checked
def features(
    positions: npt.ArrayLike,
    rate: float,
    *,
    joints: Sequence[str] | None = None,
    orientation: npt.ArrayLike | None = None,
    feature_set: str | Path = FEATURES,
) -> pl.DataFrame:
    """Compute the features of an array of joint positions.

    Parameters
    ----------
    positions : array_like of float, shape (T, J, 3)
        Joint positions in metres, Y up, as for `Take.from_positions`.
    rate : float
        Frames per second of the array.
    joints : sequence of str, optional
        The names of the J joints; by default the 24 joints of the feature set in their order.
    orientation : array_like of float, shape (T, 4), optional
        The root's orientation as unit quaternions w, x, y, z. By default it is estimated from hips and spine.
    feature_set : str or Path, optional
        A shipped feature set, or the path of a YAML file.

    Returns
    -------
    polars.DataFrame
        One row per frame at 30 frames per second and one Boolean column per feature; null in invalid frames.

    Raises
    ------
    ParameterError
        An array has another shape, the rate is out of range, or a joint has no known name.

    Examples
    --------
    >>> kinedex.features(take.positions, rate=take.rate_hz).shape == (len(take), 40)
    True
    """
    from kinedex.pipelines.ingestion.analysis import analyse, known_features

    features = load_feature_set(feature_set)
    body = body_of_array(positions, rate, features, joints, orientation)
    words = analyse(body, features, ANALYSIS_RATE_HZ)[2]
    return feature_table(words, features, known_features(features, body))
