"""Requirements that tiles of a survey do not meet: counts per tile, text of each tile, and sentences for the survey."""

import zlib
from collections.abc import Callable, Iterable

import numpy as np

from rfpsurvey.allocation import AllocationOptions, Shortfall
from rfpsurvey.constraints import FAIL, NOT_CHECKABLE, PASS, Constraint, KeepOut, Verdict
from rfpsurvey.errors import listed, number_of

MISSING, EXCESS, VIOLATED, UNKNOWN = "missing ", "too many ", "violations ", f"{NOT_CHECKABLE} "
TAG = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
WORDS = (MISSING, EXCESS, VIOLATED, UNKNOWN)
REQUIRED = "required targets"
MOST_TILES = 5
"""Largest number of tiles that a sentence lists."""


def shortfall_cards(options: AllocationOptions) -> dict[str, tuple[str, str]]:
    """Return header cards of the file of a tile for the targets that requirements lack, as in ``COUNTS``.

    Each requirement has a card for the number of missing targets and, if it has a maximum, a card for the number of
    targets above the maximum. All keep-out circles together have a card, and so has each constraint that is more than
    counts and has no short form. A constraint with a verdict of its own has a card that states if it is not checkable.
    The names of cards depend on the texts of constraints, so that files of tiles with other constraints are recognized.
    """
    cards, tags = {}, _tags([*map(str, options.counts), *map(str, options.constraints)])
    for one in options.counts:
        tag = tags[str(one)]
        cards[f"MISS{tag}"] = f"{MISSING}{one}", "targets that a requirement lacks"
        if one.maximum is not None:
            cards[f"MORE{tag}"] = f"{EXCESS}{one}", "targets above the maximum of a requirement"
    if options.required_ids:
        cards["MISSREQ"] = f"{MISSING}{REQUIRED}", "required targets of the field without a fiber"
    if options.keep_out:
        cards["VIOLKEEP"] = f"{VIOLATED}{KeepOut.name}", "violations of keep-out circles"
    for one in options.constraints:
        if one.uses_field:
            tag = tags[str(one)]
            cards[f"VIOL{tag}"] = f"{VIOLATED}{one}", "violations of a constraint"
            if type(one).verdict is not Constraint.verdict:
                cards[f"NOTC{tag}"] = f"{UNKNOWN}{one}", "1 if the constraint is not checkable"
    return cards


def _tags(texts: list[str]) -> dict[str, str]:
    """Return four letters or digits for each text, which depend on the text; those of different texts are different."""
    found: dict[str, str] = {}
    for text in texts:
        number = zlib.crc32(text.encode())
        while text not in found:
            tag = "".join(TAG[number // 36**k % 36] for k in range(4))
            if tag not in found.values():
                found[text] = tag
            number += 1
    return found


def counts_in(cards: dict[str, int], counted: dict[str, tuple[str, str]]) -> dict[str, int]:
    """Return the counts in the header cards of a tile; constraints that the tile did not have are not checkable."""
    found = {}
    for card, (name, _) in counted.items():
        found[name] = cards.get(card, int(name.startswith(UNKNOWN)))
        if card not in cards and name.startswith(WORDS):
            found[f"{UNKNOWN}{_words(name)[0]}"] = 1
    return found


def shortfall_counts(
    unmet: Iterable[Shortfall],
    violations: dict[str, list[str]],
    options: AllocationOptions,
    verdicts: Callable[[], list[Verdict]],
) -> dict[str, int]:
    """Return the numbers of missing targets, of targets above maxima, and of violations, for the cards of a tile."""
    found = {name: 0 for name, _ in shortfall_cards(options).values()}
    if any(name.startswith(UNKNOWN) for name in found):
        checked = [one for one in options.all_constraints if one.uses_field]
        for one, verdict in zip(checked, verdicts(), strict=True):
            if verdict.verdict == NOT_CHECKABLE:
                found[f"{UNKNOWN}{one}"] = 1
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
    lacking = {name: values for name, values in counts.items() if name.startswith(WORDS)}
    return {name: values for name, values in counts.items() if name not in lacking}, lacking


def texts_of(lacking: dict[str, np.ndarray], *, unknown: bool = False) -> list[str]:
    """Return, for each tile, text such as "sky=20: 3 missing, standard=5: 1 missing"; empty if nothing is missing.

    If ``unknown`` is true, the text contains only the constraints that are not checkable.
    """
    lacking = {_words(name): values for name, values in lacking.items() if name.startswith(UNKNOWN) == unknown}
    rows = zip(*(values.tolist() for values in lacking.values()), strict=True)
    return [
        ", ".join(
            what if unknown else f"{what}: {_amount(n, word)}"
            for (what, word), n in zip(lacking, row, strict=True)
            if n
        )
        for row in rows
    ]


def rule_records(lacking: dict[str, np.ndarray], tiles: np.ndarray, kept: np.ndarray | slice) -> list[dict]:
    """Return, for each constraint, the numbers of tiles with each verdict, and the tiles that fail.

    ``kept`` selects the tiles that are not dropped.

    Required targets are no constraint on a single tile, because later tiles can observe them.
    """
    found, tiles = {}, tiles[kept]
    for name, values in lacking.items():
        what, word = _words(name)
        if what != REQUIRED:
            one = found.setdefault(what, {FAIL: np.zeros(len(tiles), dtype=bool), NOT_CHECKABLE: False})
            one[NOT_CHECKABLE if word == NOT_CHECKABLE else FAIL] |= values[kept] > 0
    return [
        {
            "rule": what,
            PASS: int(np.sum(~(one[FAIL] | one[NOT_CHECKABLE]))),
            FAIL: int(np.sum(one[FAIL])),
            NOT_CHECKABLE: int(np.sum(one[NOT_CHECKABLE])),
            "tiles": listed(tiles[one[FAIL]].tolist(), MOST_TILES) if one[FAIL].any() else "",
        }
        for what, one in found.items()
    ]


def sentences_of(lacking: dict[str, np.ndarray], tiles: np.ndarray) -> list[str]:
    """Return a sentence for each requirement that tiles do not meet, which names the first of these tiles."""
    found = []
    for name, values in lacking.items():
        rows = np.flatnonzero(values)
        what, word = _words(name)
        if len(rows) and what != REQUIRED and word != NOT_CHECKABLE:  # later tiles can observe required targets
            where = f"{len(rows)} of {number_of(len(tiles), 'tile')} ({listed(tiles[rows].tolist(), MOST_TILES)})"
            kind = "constraint" if word == VIOLATED.strip() else "requirement"
            found.append(f"{kind} {what}: {_amount(int(values.sum()), word)} in {where}")
    return found


def _words(name: str) -> tuple[str, str]:
    word = next(word for word in WORDS if name.startswith(word))
    return name.removeprefix(word), word.strip()


def _amount(n: int, word: str) -> str:
    return f"{n} {word.removesuffix('s') if n == 1 else word}"
