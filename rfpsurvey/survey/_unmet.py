"""Requirements that tiles of a survey do not meet: counts per tile, text of each tile, and sentences for the survey."""

from collections.abc import Iterable

import numpy as np

from rfpsurvey.allocation import AllocationOptions, Shortfall
from rfpsurvey.constraints import KeepOut
from rfpsurvey.errors import listed, number_of

MISSING, EXCESS, VIOLATED = "missing ", "too many ", "violations "
REQUIRED = "required targets"
MOST_TILES = 5
"""Largest number of tiles that a sentence lists."""


def shortfall_cards(options: AllocationOptions) -> dict[str, tuple[str, str]]:
    """Return header cards of the file of a tile for the targets that requirements lack, as in ``COUNTS``.

    Each requirement has a card for the number of missing targets and, if it has a maximum, a card for the number of
    targets above the maximum. All keep-out circles together have a card, and so has each constraint that is more than
    counts and has no short form.
    """
    cards = {}
    for k, one in enumerate(options.counts):
        cards[f"MISS{k}"] = f"{MISSING}{one}", f"targets that requirement {k} lacks"
        if one.maximum is not None:
            cards[f"MORE{k}"] = f"{EXCESS}{one}", f"targets above the maximum of requirement {k}"
    if options.required_ids:
        cards["MISSREQ"] = f"{MISSING}{REQUIRED}", "required targets of the field without a fiber"
    if options.keep_out:
        cards["VIOLKEEP"] = f"{VIOLATED}{KeepOut.name}", "violations of keep-out circles"
    for k, one in enumerate(one for one in options.constraints if one.uses_field):
        cards[f"VIOL{k}"] = f"{VIOLATED}{one}", f"violations of constraint {k}"
    return cards


def shortfall_counts(
    unmet: Iterable[Shortfall], violations: dict[str, list[str]], options: AllocationOptions
) -> dict[str, int]:
    """Return the numbers of missing targets, of targets above maxima, and of violations, for the cards of a tile."""
    found = {name: 0 for name, _ in shortfall_cards(options).values()}
    for one in unmet:
        sign = MISSING if one.requested > one.found else EXCESS
        found[f"{sign}{REQUIRED if one.requirement is None else one.requirement}"] += abs(one.requested - one.found)
    for text, sentences in violations.items():
        name = f"{VIOLATED}{text}"
        if name not in found:  # the count of keep-out circles has their name only
            name = f"{VIOLATED}{text.partition(' ')[0]}"
        if name in found:
            found[name] += len(sentences)
    return found


def without_shortfalls(counts: dict[str, np.ndarray]) -> tuple[dict, dict]:
    """Divide the counts of all tiles into the counts that become columns, and the numbers of missing targets."""
    lacking = {name: values for name, values in counts.items() if name.startswith((MISSING, EXCESS, VIOLATED))}
    return {name: values for name, values in counts.items() if name not in lacking}, lacking


def texts_of(lacking: dict[str, np.ndarray]) -> list[str]:
    """Return, for each tile, text such as "sky=20: 3 missing, standard=5: 1 missing"; empty if nothing is missing."""
    words = [_words(name) for name in lacking]
    rows = zip(*(values.tolist() for values in lacking.values()), strict=True)
    return [", ".join(f"{what}: {_amount(n, x)}" for (what, x), n in zip(words, row, strict=True) if n) for row in rows]


def sentences_of(lacking: dict[str, np.ndarray], tiles: np.ndarray) -> list[str]:
    """Return a sentence for each requirement that tiles do not meet, which names the first of these tiles."""
    found = []
    for name, values in lacking.items():
        rows = np.flatnonzero(values)
        what, word = _words(name)
        if len(rows) and what != REQUIRED:  # later tiles can observe required targets
            where = f"{len(rows)} of {number_of(len(tiles), 'tile')} ({listed(tiles[rows].tolist(), MOST_TILES)})"
            kind = "constraint" if word == VIOLATED.strip() else "requirement"
            found.append(f"{kind} {what}: {_amount(int(values.sum()), word)} in {where}")
    return found


def _words(name: str) -> tuple[str, str]:
    word = next(word for word in (MISSING, EXCESS, VIOLATED) if name.startswith(word))
    return name.removeprefix(word), word.strip()


def _amount(n: int, word: str) -> str:
    return f"{n} {word.removesuffix('s') if n == 1 else word}"
