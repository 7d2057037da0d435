"""Lists the places where measured and simulated disagree: each covariate once, each beside the places before it.

One cause shows along many covariates, because settings go together: what is more in every dark frame differs along
exposure, source level and signal alike. The clearest place comes first; what it explains is taken out before the next
is looked for, so that the second and third are not its echoes.

Source: matching pursuit, S. Mallat, Z. Zhang, IEEE Trans. Signal Process. 41 (1993) 3397, with its orthogonal
projections (Y. C. Pati et al., 27th Asilomar Conf. (1993) 40), on the score tests of `localise`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from radiometer.reconcile.fit.linear import LinearFit
from radiometer.reconcile.fit.state import FitState
from radiometer.reconcile.measure.covariates import covariates
from radiometer.reconcile.search.localise import Basis, Disagreement, score, trend_bases

# A disagreement that is the same everywhere has no covariate of its own; this is where its statistic lies.
_AXIS_OF_CONSTANT: Final = {
    "mean": "signal",
    "slope_x": "image_x",
    "slope_y": "image_y",
    "first": "previous_frame",
    "common": "exposure_s",
    "row_temporal": "image_y",
    "bands": "image_y",
    "columns": "image_x",
    "rows": "image_y",
    "edge": "image_x",
    "outliers": "exposure_s",
}
_AXIS_OF_SHAPE: Final = {"time_waves": "timestamp_s", "half_x": "image_x", "half_y": "image_y"}


def axis_of(where: str, block: str) -> str:
    """Return the covariate that a test's axis stands for.

    Args:
        where: Axis of the test.
        block: Its statistic.
    """
    return _AXIS_OF_CONSTANT.get(block, "signal") if where == "constant" else _AXIS_OF_SHAPE.get(where, where)


def places(state: FitState, most: int) -> tuple[Disagreement, ...]:
    """Return up to so many tests, each the most significant along a covariate that is not listed yet.

    Args:
        state: The fitted model.
        most: Length of the list.
    """
    bases = tuple(trend_bases(state, covariates(state.model, state.prediction)))
    fit, found = state.fit, list[Disagreement]()
    for _ in range(most):
        taken = {axis_of(test.where, test.block) for test in found}
        left = [basis for basis in bases if axis_of(basis.where, basis.block) not in taken]
        rated = [(test, basis) for basis in left if (test := score(state, basis, fit)) is not None]
        if not rated:
            break
        test, basis = min(rated, key=lambda entry: entry[0].log_p)
        found.append(test)
        fit = _beside(state, fit, basis)
    return tuple(found)


def _beside(state: FitState, fit: LinearFit, basis: Basis) -> LinearFit:
    """Return the fit with a trend taken up."""
    lengths = np.linalg.norm(basis.columns, axis=0)
    columns = np.zeros((state.comparison.size, int(np.sum(lengths > 0))))
    columns[state.comparison.cuts[basis.block]] = basis.columns[:, lengths > 0] / lengths[lengths > 0]
    return fit.extended(fit.followed(state.pad(columns)))
