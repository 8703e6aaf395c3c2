"""Removal of characters that a page cannot contain."""

import unicodedata

__all__ = ["text_of"]

BAD = ("Cc", "Cn", "Co", "Cs")
"""Unicode categories of characters that are not text: control, unassigned and surrogate characters."""
TURNS = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
"""Characters that change the direction of the text that follows."""


def text_of(value: object) -> str:
    """Return text for a page, with replacement characters for those that are invalid or change the direction."""
    text = str(value).replace("\r\n", "\n")
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if _is_text(c) else "\N{REPLACEMENT CHARACTER}" for c in text)


def _is_text(character: str) -> bool:
    return character in "\n\t" or (unicodedata.category(character) not in BAD and character not in TURNS)
