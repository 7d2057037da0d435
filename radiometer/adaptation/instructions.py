"""Instructions to the subject, from the protocol: to be read aloud before the test."""

from __future__ import annotations

from radiometer.adaptation.protocol import AdaptationProtocol, FlashBleach


def instructions(protocol: AdaptationProtocol) -> list[str]:
    """Return what a subject must know, a sentence or two each, in the order of the test."""
    bleach, watch, minutes = protocol.bleach, protocol.watch, protocol.end.duration_min
    light = (
        "You look straight into a flash of light."
        if isinstance(bleach, FlashBleach) and bleach.source == "flash"
        else f"First you look into a bright field for {_span(bleach.duration_s)}. Keep your eye open; you may blink."
    )
    whole_min = round(bleach.duration_s / 60 + minutes)
    sentences = [
        f"This test finds how your eye gets used to the dark. It takes about {whole_min} minutes. "
        "You may end it at any time.",
        light,
        "Then it is dark. Look at the small red mark all the time, also while you wait.",
        f"To the side of the mark a spot blinks, for {protocol.spot.on_s:g} s each time. "
        "Press the button as soon as you notice it, however faint. Do not look at the spot.",
        "Press only when you see a light. Now and then nothing is shown, to find out how often the button is pressed "
        "by mistake.",
    ]
    if protocol.fixation_check is not None:
        sentences.append(
            "Now and then a red light is shown where you cannot see it as long as you look at the mark. "
            "If you see a red light, press, and look at the mark again."
        )
    sentences += [
        f"At first you may see nothing for up to {watch.blind_min:g} minutes. "
        "That is normal: your eye recovers from the bright light.",
        f"If you need a pause, hold the button for {watch.hold_to_pause_s:g} s. Press once to go on. "
        f"In the pause stay in the dark; after {watch.longest_pause_min:g} minutes the test ends.",
    ]
    if bleach.pupil_mm is not None:
        sentences.append(
            f"(For the operator: the protocol counts on a pupil of {bleach.pupil_mm:g} mm. "
            "Measure it in the dark, state it with --pupil, and cover the other eye.)"
        )
    return sentences


def _span(seconds: float) -> str:
    return f"{seconds:g} seconds" if seconds < 90 else f"{seconds / 60:g} minutes"
