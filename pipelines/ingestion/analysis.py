"""What a body becomes: frames and words at the analysis rate, and what its skeleton costs; for ingest and inspect."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.ops.body import features
from kinedex.ops.body.resample import feature_rate, resample
from kinedex.storage.formats.motion.reader import Body

F64 = npt.NDArray[np.float64]


def analyse(body: Body, feature_set: FeatureSet, rate_hz: float) -> tuple[F64, F64, npt.NDArray[np.uint64]]:
    """Compute features at the source's own rate, and keep every frame of the analysis rate.

    Returns
    -------
    positions (J, 3, T), the root's orientation (4, T), and words (T,), at `rate_hz`; `NO_WORD` in invalid frames.
    """
    rate = feature_rate(body.rate_hz, rate_hz)
    at_rate = resample(body.positions, body.orientation, body.rate_hz, rate, body.valid)
    words = features.words(
        at_rate.positions, at_rate.orientation, rate, feature_set.rules, at_rate.valid, feature_set.plugin_primitives
    )
    step = round(rate / rate_hz)
    return at_rate.positions[:, :, ::step], at_rate.orientation[:, ::step], words[::step]


def blind(feature_set: FeatureSet, body: Body) -> list[str]:
    """What joints that the skeleton does not have cost: the features that are off, and those that do without them."""
    if not body.unknown:
        return []
    off, narrowed = feature_set.without(body.unknown)
    said = [
        f"skeleton mapping '{body.skeleton}' has no {', '.join(body.unknown)}; these features are off: "
        + (", ".join(f"F{feature.number} {feature.name}" for feature in off) or "none")
    ]
    if narrowed:
        names = ", ".join(f"F{feature.number} {feature.name}" for feature in narrowed)
        said.append(f"without {', '.join(body.unknown)} these features look at the other joints only: {names}")
    return said
