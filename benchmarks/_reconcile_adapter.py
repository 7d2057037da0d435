"""Asks the finder: one session in, its documented JSON out."""

from __future__ import annotations

from typing import Any

from radiometer.reconciliation.result import ReconcileResult
from testing.generator.session import Session
from testing.reconciled import gaps_of as gaps_under
from testing.reconciled import reconcile


def ask(
    session: Session, without: tuple[str, ...] = (), *, with_limits: bool = False
) -> tuple[dict[str, Any], ReconcileResult]:
    """Return the finder's answer to a session as JSON and as it is; it sees header and frames, never the truth."""
    found = reconcile(session.header, list(session.frames()), without=without, with_limits=with_limits)
    return found.to_mapping(), found


def gaps_of(found: ReconcileResult, session: Session) -> tuple[float, float]:
    """Return the reduced chi-square of a session with nothing and with the found effects frozen, nuisances fitted."""
    before, after = gaps_under((None, found), session.header, list(session.frames()))
    return float(before), float(after)
