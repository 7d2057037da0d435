"""`radiometer passport`: sessions of one camera over years: what changed, what did not, and what was the light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import radiometer as rm
from radiometer.cli.console import console
from radiometer.cli.function import command_of

if TYPE_CHECKING:
    from radiometer.api.archive import Passport


def _show(found: rm.Passports) -> None:
    for one in found.cameras:
        _show_camera(one)


def _show_camera(passport: Passport) -> None:
    out = console()
    out.print(f"[bold]{' '.join(passport.camera)}[/bold]: {len(passport.sessions)} sessions")
    for session in passport.sessions:
        when = session.taken.date().isoformat() if session.taken else "undated"
        out.print(f"  {when}  {session.name}: {len(session.figures)} figures")
        for line in session.notes:
            out.print(f"      [yellow]note[/yellow] {line}")
    law = passport.dark_law
    if law is not None:
        out.print(
            f"dark current doubles per {law.doubling_k.text(with_k=True)} from "
            f"{law.between_c[0]:.0f} to {law.between_c[1]:.0f} °C, {law.rate_at_0.value:.3g} DN/s at 0 °C; "
            f"points scatter {law.birge_ratio:.1f} times their u: "
            f"{'one law fits all' if law.is_one else 'no single law fits'}"
        )
        share = law.generation_share
        if share is not None:
            out.print(
                f"  {share.scaled(100.0, '%').text(with_k=True)} of it are generation, the rest diffusion: the colder, "
                "the slower it doubles"
            )
        for one in law.doublings:
            measured = one.measured_k.text(with_k=True)
            out.print(f"  {one.session} by itself: {measured}, by the law {one.expected_k:.2f} K there")
        if law.doublings_apart_u is not None:
            out.print(f"  these differ as the law predicts, within {law.doublings_apart_u:.1f} u")
        for name, temperature_c, rate, distance in law.points:
            out.print(f"  {temperature_c:6.1f} °C  {rate:9.4g} DN/s  {distance:+.1f} u  {name}")
    for line in passport.gain:
        out.print(f"gain: {line}")
    for change in passport.changes:
        word = "[yellow]changed[/yellow]" if change.changed else "unchanged"
        out.print(f"{change.quantity}: {word} ({change.what})")
    for line in passport.light:
        out.print(f"light: {line}")


command = command_of("passport", _show)
