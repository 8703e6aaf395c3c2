"""Replacement of characters that a page cannot contain."""

import unicodedata

BAD = ("Cc", "Cn", "Co", "Cs")
"""Unicode categories of characters that are not text: control, unassigned, private-use and surrogate characters."""
TURNS = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
"""Characters that change the direction of the text that follows."""


def text_of(value: object) -> str:
    """Return a value as text for a page; characters that are invalid or change the direction of text are replaced."""
    text = str(value).replace("\r\n", "\n")
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if _is_text(c) else "\N{REPLACEMENT CHARACTER}" for c in text)


def _is_text(character: str) -> bool:
    return character in "\n\t" or (unicodedata.category(character) not in BAD and character not in TURNS)
