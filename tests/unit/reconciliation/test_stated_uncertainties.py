"""What a stated uncertainty is made of: its unit, its size where the model misfits, priors, biases of logarithms."""

import numpy as np

from radiometer.reconciliation.fit.state import inverse, prior_residual


def test_a_prior_is_an_observation_that_the_parameter_is_nothing():
    """Residual 0 − 6 over 2, and its derivative with the sign turned 1/2; without a stated size neither."""
    prior = np.array([2.0, np.inf])
    assert prior_residual(prior, np.array([6.0, 5.0])).tolist() == [-3.0, 0.0]
    assert inverse(prior).tolist() == [0.5, 0.0]
