"""Analysis of bodies: frames and words at the analysis rate, and the features that a skeleton lacks joints for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.ops.body import features
from kinedex.ops.body.resample import feature_rate, resample
from kinedex.storage.formats.motion.reader import Body

F64 = npt.NDArray[np.float64]


def analyse(body: Body, feature_set: FeatureSet, rate_hz: float) -> tuple[F64, F64, npt.NDArray[np.uint64]]:
    """Compute features at the rate of the source, and sample them at the analysis rate.

    Parameters
    ----------
    body : Body
        The positions of joints at the source rate.
    feature_set : FeatureSet
        The features to compute.
    rate_hz : float
        The analysis rate, in frames per second.

    Returns
    -------
    positions : float64 array (J, 3, T)
        In metres.
    orientation : float64 array (4, T)
        The orientation of the root, as quaternions.
    words : uint64 array (T,)
        `NO_WORD` in invalid frames.
    """
    rate = feature_rate(body.rate_hz, rate_hz)
    at_rate = resample(body.positions, body.orientation, body.rate_hz, rate, body.valid)
    words = features.words(
        at_rate.positions, at_rate.orientation, rate, feature_set.rules, at_rate.valid, feature_set.plugin_primitives
    )
    step = round(rate / rate_hz)
    return at_rate.positions[:, :, ::step], at_rate.orientation[:, ::step], words[::step]


def blind(feature_set: FeatureSet, body: Body) -> list[str]:
    """Return warnings on joints that a skeleton lacks: features that are off, or use the other joints only."""
    if not body.unknown:
        return []
    off, narrowed = feature_set.without(body.unknown)
    warnings = [
        f"skeleton mapping '{body.skeleton}' has no {', '.join(body.unknown)}; these features are off: "
        + (", ".join(f"F{feature.number} {feature.name}" for feature in off) or "none")
    ]
    if narrowed:
        names = ", ".join(f"F{feature.number} {feature.name}" for feature in narrowed)
        warnings.append(f"without {', '.join(body.unknown)} these features use the other joints only: {names}")
    return warnings
