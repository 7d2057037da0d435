"""Right or wrong: the documented JSON answer held against the secret of a session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from testing.outside.session import Secret

# What results may call a covariate of the secret.
PLACES = {
    "image_x": {"image_x", "screen_x", "field_radius"},
    "image_y": {"image_y", "screen_y", "field_radius"},
    "image_xy": {"image_x", "image_y", "screen_x", "screen_y", "field_radius"},
    "turn": {"turn", "frame", "previous_frame", "repeat"},
    "frame": {"frame", "previous_frame"},
    "idle_s": {"idle_s", "timestamp_s", "previous_frame"},
    "signal": {"signal", "patch_level", "code"},
}
YES_NO = ("found", "first", "exact", "junk", "confident_wrong", "place")


def judge(answer: Mapping[str, Any], secret: Secret) -> dict[str, Any]:
    """Return what is right and wrong about an answer.

    Args:
        answer: The documented JSON object of a result.
        secret: What was hidden.

    Returns:
        found: something is reported missing; first: the first thing reported is right (a right name, an inseparable
        name, or a name with a right one as alternative); exact: that and nothing else; junk: a name
        that is not right stands there; confident_wrong: that with the verdict effects_found; place: a true covariate
        is among the first three places; alternatives: how many stand there.
    """
    effects = answer["effects"]
    named = [effect for effect in effects if effect["name"] != "unnamed"]
    wrong = [effect["name"] for effect in named if not is_right(effect, secret)]
    places = [place["covariate"] for place in answer["localisation"]][:3]
    places += [effect["where"] for effect in effects if effect["name"] == "unnamed"]
    return {
        "verdict": answer["verdict"],
        "names": [effect["name"] for effect in effects],
        "wrong": wrong,
        "found": answer["verdict"] != "agrees",
        "first": bool(effects) and effects[0]["name"] != "unnamed" and is_right(effects[0], secret),
        "exact": bool(effects) and len(named) == len(effects) == 1 and not wrong,
        "junk": bool(wrong),
        "confident_wrong": bool(wrong) and answer["verdict"] == "effects_found",
        "place": any(place in PLACES.get(c, {c}) for c in secret.covariates for place in places),
        "alternatives": sum(len(effect["alternatives"]) for effect in effects),
    }


def is_right(effect: Mapping[str, Any], secret: Secret) -> bool:
    """Tell whether a name, or one that is its alternative, is right."""
    return bool(set(secret.right) & {effect["name"], *effect["alternatives"]})


def tally(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of what was run, one line for each kind, in Markdown."""
    lines = [
        "| hidden | sessions | something found | right name first | right name alone | a wrong name | "
        "confidently wrong | true covariate among three | crashes |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(str(result["kind"]) for result in results):
        own = [result for result in results if result["kind"] == kind]
        judged = [result["judged"] for result in own if "judged" in result]
        counts = [f"{sum(bool(j[key]) for j in judged)}/{len(judged)}" for key in YES_NO]
        unasked = {"null": ("first", "exact", "place"), "outsider": ("first", "exact")}.get(kind, ("place",))
        cells = ["–" if key in unasked else count for key, count in zip(YES_NO, counts, strict=True)]
        lines.append(
            f"| {'variant' if kind == 'law' else kind} | {len(own)} | "
            + " | ".join(cells)
            + f" | {len(own) - len(judged)} |"
        )
    return "\n".join(lines)
