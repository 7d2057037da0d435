"""Proposes a law for what no entry of the catalogue explains: stage, covariates, formula, effect file."""

from radiometer.reconcile.propose.files import write_files
from radiometer.reconcile.propose.proposal import Proposal
from radiometer.reconcile.propose.search import propose_law

__all__ = ["Proposal", "propose_law", "write_files"]
