"""Requirements that tiles of a survey do not meet: counts per tile, text of each tile, and sentences for the survey."""

import zlib
from typing import NamedTuple

import numpy as np

from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.constraints import FAIL, NOT_CHECKABLE, PASS, Constraint, KeepOut
from rfpsurvey.errors import listed, number_of
from rfpsurvey.pipeline import FieldPlan

MISSING, EXCESS, VIOLATED = "missing", "too many", "violations"
TAG = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
REQUIRED = "required targets"
MOST_TILES = 5
"""Largest number of tiles that a sentence lists."""


class CountOfRule(NamedTuple):
    """The name of a number of missing targets, of targets above a maximum, or of violations, in the plan of a tile."""

    what: str
    """Text of the constraint."""
    word: str
    """Text on the number; ``not checkable`` if it is 1 for a plan that lacks the data of the constraint."""

    def text(self, n: int) -> str:
        """Return text on the number, such as "sky=20: 3 missing"."""
        return f"{self.what}: {n} {self.word.removesuffix('s') if n == 1 else self.word}"


def is_unknown(name: str | CountOfRule) -> bool:
    """Return whether a number states that a constraint is not checkable."""
    return isinstance(name, CountOfRule) and name.word == NOT_CHECKABLE


def shortfall_cards(options: AllocationOptions) -> dict[str, tuple[CountOfRule, str]]:
    """Return header cards of the file of a tile for the targets that requirements lack, as in ``COUNTS``.

    Each requirement has a card for the number of missing targets and, if it has a maximum, a card for the number of
    targets above the maximum. All keep-out circles together have a card, and so has each constraint that is more than
    counts and has no short form. A constraint with a verdict of its own has a card that states if it is not checkable.
    The names of cards depend on the texts of constraints, so that files of tiles with other constraints are recognized.
    """
    cards, tags = {}, _tags([*map(str, options.counts), *map(str, options.constraints)])
    for requirement in options.counts:
        tag = tags[str(requirement)]
        cards[f"MISS{tag}"] = CountOfRule(str(requirement), MISSING), "targets that a requirement lacks"
        if requirement.maximum is not None:
            cards[f"MORE{tag}"] = CountOfRule(str(requirement), EXCESS), "targets above the maximum of a requirement"
    if options.required_ids:
        cards["MISSREQ"] = CountOfRule(REQUIRED, MISSING), "required targets of the field without a fiber"
    if options.keep_out:
        cards["VIOLKEEP"] = CountOfRule(KeepOut.name, VIOLATED), "violations of keep-out circles"
    for constraint in options.constraints:
        if constraint.uses_field:
            text = str(constraint)
            cards[f"VIOL{tags[text]}"] = CountOfRule(text, VIOLATED), "violations of a constraint"
            if type(constraint).verdict is not Constraint.verdict:
                cards[f"NOTC{tags[text]}"] = CountOfRule(text, NOT_CHECKABLE), "1 if the constraint is not checkable"
    return cards


def _tags(texts: list[str]) -> dict[str, str]:
    """Return four letters or digits for each text, which depend on the text; those of different texts are different."""
    tags: dict[str, str] = {}  # FITS keywords, such as MISS and a tag, have at most eight characters
    for text in dict.fromkeys(texts):
        number = zlib.crc32(text.encode())
        while (tag := "".join(TAG[number // 36**k % 36] for k in range(4))) in tags.values():
            number += 1
        tags[text] = tag
    return tags


def counts_in(cards: dict[str, int], counted: dict[str, tuple[str | CountOfRule, str]]) -> dict[str | CountOfRule, int]:
    """Return the counts in the header cards of a tile; constraints that the tile did not have are not checkable."""
    counts = {}
    for card, (name, _) in counted.items():
        counts[name] = cards.get(card, int(is_unknown(name)))
        if card not in cards and isinstance(name, CountOfRule):
            counts[name._replace(word=NOT_CHECKABLE)] = 1
    return counts


def shortfall_counts(plan: FieldPlan, options: AllocationOptions) -> dict[CountOfRule, int]:
    """Return the numbers of missing targets, of targets above maxima, and of violations, for the cards of a tile."""
    counts = {name: 0 for name, _ in shortfall_cards(options).values()}
    if any(map(is_unknown, counts)):
        checked = [constraint for constraint in options.all_constraints if constraint.uses_field]
        for constraint, verdict in zip(checked, plan.verdicts(), strict=True):
            if verdict.verdict == NOT_CHECKABLE:
                counts[CountOfRule(str(constraint), NOT_CHECKABLE)] = 1
    for lack in plan.allocation.unmet:
        what = REQUIRED if lack.requirement is None else str(lack.requirement)
        n_missing = lack.requested - lack.found
        counts[CountOfRule(what, MISSING if n_missing > 0 else EXCESS)] += abs(n_missing)
    for text, sentences in plan.violations.items():
        name = CountOfRule(text, VIOLATED)
        if name not in counts:  # the count of keep-out circles has their name only
            name = CountOfRule(text.partition(" ")[0], VIOLATED)
        if name in counts:
            counts[name] += len(sentences)
    return counts


def texts_of(lacking: dict[CountOfRule, np.ndarray], *, unknown: bool = False) -> list[str]:
    """Return, for each tile, text such as "sky=20: 3 missing, standard=5: 1 missing"; empty if nothing is missing.

    If ``unknown`` is true, the text contains only the constraints that are not checkable.
    """
    lacking = {name: values for name, values in lacking.items() if is_unknown(name) == unknown}
    rows = zip(*(values.tolist() for values in lacking.values()), strict=True)
    return [
        ", ".join(name.what if unknown else name.text(n) for name, n in zip(lacking, row, strict=True) if n)
        for row in rows
    ]


def rule_records(lacking: dict[CountOfRule, np.ndarray], tiles: np.ndarray, kept: np.ndarray | slice) -> list[dict]:
    """Return, for each constraint, the numbers of tiles with each verdict, and the tiles that fail.

    ``kept`` selects the tiles that are not dropped.

    Required targets are no constraint on a single tile, because later tiles can observe them.
    """
    verdicts_of, tiles = {}, tiles[kept]
    for name, values in lacking.items():
        if name.what != REQUIRED:
            verdicts = verdicts_of.setdefault(name.what, np.zeros((2, len(tiles)), dtype=bool))
            verdicts[int(is_unknown(name))] |= values[kept] > 0
    records = []
    for what, (fails, unknown) in verdicts_of.items():
        counts = {PASS: ~(fails | unknown), FAIL: fails, NOT_CHECKABLE: unknown}
        records.append({"rule": what, **{name: int(tiles_of.sum()) for name, tiles_of in counts.items()}})
        records[-1]["tiles"] = listed(tiles[fails].tolist(), MOST_TILES) if fails.any() else ""
    return records


def sentences_of(lacking: dict[CountOfRule, np.ndarray], tiles: np.ndarray) -> list[str]:
    """Return a sentence for each requirement that tiles do not meet, which names the first of these tiles."""
    sentences = []
    for name, values in lacking.items():
        rows = np.flatnonzero(values)
        if len(rows) and name.what != REQUIRED and not is_unknown(name):  # later tiles can observe required targets
            where = f"{len(rows)} of {number_of(len(tiles), 'tile')} ({listed(tiles[rows].tolist(), MOST_TILES)})"
            kind = "constraint" if name.word == VIOLATED else "requirement"
            sentences.append(f"{kind} {name.text(int(values.sum()))} in {where}")
    return sentences
