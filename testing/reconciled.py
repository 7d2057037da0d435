"""Frames in memory reconciled, and the gaps that given models leave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from radiometer.data import CaptureHeader, Frame
from radiometer.errors import CaptureError
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation import ReconcileResult
from radiometer.reconciliation.descent import first_state
from radiometer.reconciliation.engine import evidence_for, examine, whole_catalogue
from simulators.chain.camera_model import CameraModel
from simulators.effects.catalogue import CatalogueEffect


def reconcile(
    header: CaptureHeader,
    frames: Iterable[Frame],
    model: CameraModel | None = None,
    *,
    catalogue: Mapping[str, type[CatalogueEffect]] | None = None,
    without: Sequence[str] = (),
    with_limits: bool = True,
) -> ReconcileResult:
    """Return what `examine` finds in frames that are in memory, some entries of the catalogue left out.

    Raises:
        CaptureError: If frames are missing.
    """
    held = list(frames)
    if len(held) != len(header.frames):
        raise CaptureError(f"the header lists {len(header.frames)} frames, but {len(held)} were given")
    known = whole_catalogue() if catalogue is None else catalogue
    entries = {name: kind for name, kind in known.items() if name not in without}
    return examine(header, held.__getitem__, held[0].shape, model, catalogue=entries, with_limits=with_limits).result


@on_one_blas_thread
def gaps_of(
    found: Sequence[ReconcileResult | None], header: CaptureHeader, frames: Iterable[Frame]
) -> tuple[float, ...]:
    """Return the reduced χ² of held-out settings under the effects of results, or of none, frozen; nuisances fitted."""
    held = list(frames)
    design, _, reduced = evidence_for(header, held[0].shape, held.__getitem__)
    return tuple(first_state(design, *reduced, () if entry is None else entry.added).gap for entry in found)
