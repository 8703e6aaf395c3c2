"""Find words and phrases that the documentation avoids; print their locations, and exit with 1 if there are any.

The script checks README.rst, CHANGES.rst, the pages and examples in docs/, and the docstrings, comments, help texts and
messages of the package. It ignores code in double backquotes and doctests. A phrase may extend over two lines.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]

# Regular expression (a blank matches any white space), and the words to use instead.
WORDS = {
    r"aim(s|ed|ing)?": "objective; intend",
    r"anew": "again",
    r"as (many|far|often|long|good) as (asked|may be)": "name the subject: as many as requested by ...",
    r"as (asked|wanted|promised)": "name the subject: as requested by ...",
    r"at (the|our) door": "on input",
    r"at home": "parked, folded",
    r"(at|on) (his|her|one's) own": "separately",
    r"beats?": "is better than",
    r"blind (to|for)": "ignores",
    r"cost(s)? nothing": "uses no memory, takes no time",
    r"cuts? (\w+ )?short": "ends",
    r"fates?": "outcome, status",
    r"(goes|go|went) away": "closes, ends",
    r"half written|whole or not at all": "incomplete",
    r"honest(ly)?": "uncertainty, standard error",
    r"how good": "the quality of",
    r"knows? nothing (of|about)": "ignores",
    r"(?<!DESI\x20)ledgers?|the books": "bookkeeping, checkpoint",
    r"may be (?=[.,;:)])": "is allowed",
    r"looks? at (it|them|the|no|all|these|those|collisions|priorities)": "considers, tests, observes",
    r"mend(s|ed|ing)?": "repair, correct, fix",
    r"nobody|somebody": "name the subject",
    r"middle": "center, midpoint",
    r"of ours|of our own|our own": "of this package",
    r"once more": "again",
    r"pictures?": "plot, figure",
    r"put(s)? together": "make, combine",
    r"raises? what (it|they) likes?": "can raise any exception",
    r"risks?": "collision probability",
    r"safe distances?": "minimum separation, clearance",
    r"says? so": "states",
    r"speaks? of": "refers to",
    r"short-sighted(ly)?": "undercovers",
    r"so many": "the number of; this many",
    r"tells? (the|a|one) \w+ from": "distinguishes",
    r"there and back": "round trip",
    r"to be had": "available",
    r"twins?": "repeated identifiers",
    r"unasked": "by default",
    r"unlike each other": "different",
    r"what became of": "the outcome of",
    r"what (came|comes) (out|back)": "result",
    r"what (is|are|was|were) (asked|wanted)": "request",
    r"wish(es|ed)?": "constraint, requirement",
    r"written down": "recorded",
}
# Phrases that are allowed in a file.
ALLOWED = {
    "rfpsurvey/report/_tables.py": ("middle",),  # the panel between two others
}
CODE = re.compile(r"``.*?``|`[^`]*`_?|:\w+:`[^`]*`", re.DOTALL)
DOCTEST = re.compile(r"^[ \t]*>>> .*(\n[ \t]*\S.*)*", re.MULTILINE)
BLANK = r"\s+(?:#\s*)?"  # also matches the line break in a comment
GROUPS = [f"(?P<w{k}>{word.replace(' ', BLANK)})" for k, word in enumerate(WORDS)]
PATTERN = re.compile(rf"\b(?:{'|'.join(GROUPS)})(?![\w-])", re.IGNORECASE)


def texts_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the texts of a file, with the number of the first line of each text."""
    content = path.read_text()
    if path.suffix != ".py":
        yield 1, content
        return
    for node in ast.walk(ast.parse(content)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value
    comments: list[tuple[int, str]] = []
    for token in tokenize.generate_tokens(io.StringIO(content).readline):
        if token.type == tokenize.COMMENT:
            if comments and token.start[0] != comments[-1][0] + 1:
                yield comments[0][0], "\n".join(text for _, text in comments)
                comments = []
            comments.append((token.start[0], token.string))
    if comments:
        yield comments[0][0], "\n".join(text for _, text in comments)


def hide(match: re.Match) -> str:
    """Return a placeholder with the line breaks of a match, so that the numbers of later lines remain correct."""
    return "code" + "\n" * match.group().count("\n")


def words_in(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield the line (counted from 0) of each phrase in a text, the phrase, and the words to use instead."""
    text = CODE.sub(hide, DOCTEST.sub(hide, text))
    for match in PATTERN.finditer(text):
        advice = list(WORDS.values())[int(match.lastgroup[1:])]
        yield text.count("\n", 0, match.start()), " ".join(match.group().split()).lower(), advice


def checked_files() -> list[Path]:
    """Return the files to check."""
    found = [ROOT / "README.rst", ROOT / "CHANGES.rst", *(ROOT / "docs").glob("*.rst")]
    for folder in ("docs/examples", "docs/reproduction", "rfpsurvey"):
        found += [path for path in (ROOT / folder).rglob("*.py") if path.name != "_version.py"]
    return sorted(found)


if __name__ == "__main__":
    n_found = 0
    for path in checked_files():
        name = path.relative_to(ROOT).as_posix()
        for begin, text in texts_of(path):
            for line, phrase, advice in words_in(text):
                if phrase not in ALLOWED.get(name, ()):
                    print(f"{name}:{begin + line}: {phrase!r}; write: {advice}")
                    n_found += 1
    print(f"words: {n_found} to avoid" if n_found else "words: all well")
    sys.exit(n_found > 0)
