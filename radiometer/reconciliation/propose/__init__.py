"""Proposes a law for what no entry of the catalogue explains: stage, covariates, formula, effect file."""

from radiometer.reconciliation.propose.search import Proposal, propose_law, write_files

__all__ = ["Proposal", "propose_law", "write_files"]
