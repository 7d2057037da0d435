"""Proposes a law for what no entry of the catalogue explains: stage, covariates, formula, effect file."""

from radiometer.propose.proposal import Proposal
from radiometer.propose.search import propose_law

__all__ = ["Proposal", "propose_law"]
