"""Abbreviations of long names, such as categories, in legends and beside bars."""

from collections.abc import Sequence

MOST = 22
"""Largest number of characters of an abbreviated name."""
DOTS = "\N{HORIZONTAL ELLIPSIS}"


def short_names(names: Sequence[str], most: int = MOST) -> list[str]:
    """Return names of at most ``most`` characters; different names remain different.

    Dots replace the central part of a long name. If two abbreviations would be equal, more of the beginning or of the
    end of the names is kept; if they are still equal, the abbreviations end with numbers.
    """
    names = list(names)
    for head in (most // 2, most // 4, 3 * most // 4, 1, most - 2):
        end = most - 1 - head
        found = [one if len(one) <= most else one[:head] + DOTS + one[-end:] for one in names]
        if len(set(found)) == len(set(names)):
            return found
    number = {name: k for k, name in enumerate(dict.fromkeys(names), 1)}
    return [f"{name[: most - 1 - len(str(number[name]))]}{DOTS}{number[name]}" for name in names]
