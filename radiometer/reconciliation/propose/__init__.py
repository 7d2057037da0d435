"""Proposes a law for what no entry of the catalogue explains: stage, covariates, formula, effect file."""

from radiometer.reconciliation.propose.proposal import Proposal, write_files
from radiometer.reconciliation.propose.search import propose_law

__all__ = ["Proposal", "propose_law", "write_files"]
